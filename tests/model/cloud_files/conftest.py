"""Forks that read MATLAB files in the place of new processes."""

from ...files.mat_readers import mat_files_read_in_forks  # noqa: F401
