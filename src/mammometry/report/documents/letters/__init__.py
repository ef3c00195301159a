"""Letters of all scripts in PDF: order, shapes and fonts."""
