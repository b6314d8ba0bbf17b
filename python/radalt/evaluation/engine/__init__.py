"""The sweep engine of all studies: workers and command line."""
