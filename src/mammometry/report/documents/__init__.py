"""Pages and paper: a report, a comparison, a study, a batch."""
