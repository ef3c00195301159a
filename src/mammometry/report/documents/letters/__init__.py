"""Text of all scripts in PDF: order, shapes and fonts of letters."""
