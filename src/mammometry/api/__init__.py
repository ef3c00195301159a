"""The Python interface of mammometry."""
