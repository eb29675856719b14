"""``python -m hilbench.cli``: the same as the ``hilbench`` command."""

from hilbench.cli.main import main

main()
