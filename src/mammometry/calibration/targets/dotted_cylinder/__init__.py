"""The dotted cylinder of the paper: its sheet, its body and how it is found."""
