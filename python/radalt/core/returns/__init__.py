"""Radar returns: point targets, the altitudes of a landing, terrain."""
