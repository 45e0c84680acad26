"""File formats of tracking data, stations and Earth orientation, with errors reported by line."""
