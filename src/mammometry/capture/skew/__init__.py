"""When each camera exposed, read from a row of counting lamps."""
