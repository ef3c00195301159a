"""What all servers of pages share: limits, replies, and the login of the one person at this computer."""
