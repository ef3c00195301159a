"""The trunk under the breasts."""
