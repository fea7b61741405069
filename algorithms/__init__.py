"""The built-in estimators and detectors: the first plugin package of isacbench."""
