"""``python -m hilbench.cli``: the same as the ``hilbench`` command, for child processes."""

from hilbench.cli.main import main

main()
