"""Records that can be found and put right.

Search, near duplicates, corrections with their undoing, the bin.
"""
