"""One results kit: scores, folders, journals."""
