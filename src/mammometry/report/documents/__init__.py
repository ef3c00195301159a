"""Web pages and PDF documents: a report, a comparison, a study, a batch."""
