"""The boundary of a breast."""

TO_BE_CONFIRMED = "to be confirmed by eye"
"""Words in the method of an automatic boundary. `measure.volume.attribution` drops them once somebody confirmed it."""
