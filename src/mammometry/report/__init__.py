"""The report: its text, figures and documents."""
