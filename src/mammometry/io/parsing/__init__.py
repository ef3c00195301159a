"""Tables and texts of other programs, read strictly."""
