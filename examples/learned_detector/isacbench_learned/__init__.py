"""A learned detector for isacbench, to start a package of one's own from."""
