"""One results kit: chains, scores, folders, tables, pages."""
