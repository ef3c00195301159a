"""The report: its content, figures and documents."""
