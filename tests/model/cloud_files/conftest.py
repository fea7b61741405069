"""How files of clouds are read."""

from ...files.mat_readers import mat_files_read_in_forks  # noqa: F401
