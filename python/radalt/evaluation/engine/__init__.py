"""What every study runs on: worker processes and the console."""
