"""What people bring: inputs made by code, each with the number or the sentence that must come."""
