"""From frames to 25 altitudes per second, each with a status and a protection level."""
