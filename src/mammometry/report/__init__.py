"""The report: its words, figures and documents."""
