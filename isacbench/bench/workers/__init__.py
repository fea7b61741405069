"""Worker processes: guarded cells on this machine and on others."""
