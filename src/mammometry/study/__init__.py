"""Agreement and accuracy: is the instrument right?"""
