"""What comes back from the ground: point targets, the altitudes of a landing, terrain."""
