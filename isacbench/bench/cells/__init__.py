"""One cell of a run: an estimate that is timed, scored and recorded."""
