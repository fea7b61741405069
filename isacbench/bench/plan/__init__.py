"""The plan of a run: cells, blocks, and the job that other processes work on."""
