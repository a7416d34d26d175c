"""``python -m rvm_mpi``: the same as the command ``rvm``."""

import sys

from rvm_mpi.commands.main import main

if __name__ == "__main__":
    sys.exit(main())
