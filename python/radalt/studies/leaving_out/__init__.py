"""Study: what leaving out saves, and that it changes no result."""
