"""Arrays of numbers in files: how they lie there, and how parts of them are read."""
