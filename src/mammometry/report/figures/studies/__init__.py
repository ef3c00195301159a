"""Pictures of more than one measurement: dates, methods, observers, truth."""
