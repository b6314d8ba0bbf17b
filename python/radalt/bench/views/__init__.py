"""Views of rows: each a table or a figure of a run's report."""
