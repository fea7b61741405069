"""Point clouds in files of several formats."""
