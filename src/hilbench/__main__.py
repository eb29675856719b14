"""``python -m hilbench``: the same as the ``hilbench`` command."""

from hilbench.apps.cli.main import main

main()
