"""What stands before the subject: hair, rails and other things that hide skin or bound no silhouette."""
