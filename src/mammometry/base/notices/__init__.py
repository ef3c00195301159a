"""Notices: remarks on results, as codes with values, and the catalogue of their texts."""

from mammometry.base.notices.notice import Level, Notice, from_table
from mammometry.base.notices.words import words_of

__all__ = ["Level", "Notice", "from_table", "words_of"]
