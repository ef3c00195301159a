"""The chest wall that closes a breast."""
