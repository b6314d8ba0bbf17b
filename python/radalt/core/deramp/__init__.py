"""A deramping altimeter in absolute units: its mixer's output, computed directly at the IF rate."""
