"""What every study runs on: the sweep engine, its workers, its command line."""
