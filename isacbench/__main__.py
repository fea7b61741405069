"""Run the command line as ``python -m isacbench``."""

from isacbench.cli import main

if __name__ == "__main__":
    main()
