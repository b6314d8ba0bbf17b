"""Results of all studies: chains, scores, folders, tables, pages."""
