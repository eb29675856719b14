"""Commands are entry points: those of other packages are found, and what can't be loaded harms no other."""

from __future__ import annotations

from pathlib import Path

from tests.installed import hilbench_with, install

GROUP = "hilbench.commands"
SOURCE = '''
import typer

def weigh(grams: float) -> None:
    """Weigh a roll."""
    print(f"{grams / 1e3:g} kg")

scales = typer.Typer(help="Set up the scales.", no_args_is_help=True)

@scales.command()
def tare() -> None:
    """Set the scales to zero."""
    print("0 kg")

@scales.command()
def show() -> None:
    """Show what is on them."""
'''


def test_a_command_and_a_group_of_another_package_are_hilbench_s(tmp_path: Path) -> None:
    install(tmp_path, "weighing", SOURCE, GROUP, weigh_roll="weigh", scales="scales")
    assert hilbench_with(tmp_path, "weigh-roll", 2500).stdout == "2.5 kg\n"
    assert hilbench_with(tmp_path, "scales", "tare").stdout == "0 kg\n"
    shown = hilbench_with(tmp_path, "--help").stdout
    assert "Weigh a roll." in shown
    assert "Set up the scales." in shown


def test_one_that_cannot_be_imported_is_a_line_and_the_others_are_there(tmp_path: Path) -> None:
    install(tmp_path, "broken", "raise RuntimeError('no scales')\n", GROUP, weigh_roll="weigh")
    alone = hilbench_with(tmp_path, "weigh-roll")
    assert (alone.returncode, alone.stdout) == (2, "")
    assert alone.stderr.startswith(
        f"hilbench: {GROUP} weigh-roll: broken:weigh of broken can't be loaded (RuntimeError:"
    )
    shown = hilbench_with(tmp_path, "--help")
    assert (shown.returncode, shown.stderr) == (0, alone.stderr)
    assert "Check a config" in shown.stdout
    assert hilbench_with(tmp_path, "examples").stderr == ""


def test_a_command_of_hilbench_is_not_replaced(tmp_path: Path) -> None:
    install(tmp_path, "weighing", SOURCE, GROUP, examples="weigh")
    assert "web_section_step" in hilbench_with(tmp_path, "examples").stdout
    assert "Weigh a roll." not in hilbench_with(tmp_path, "--help").stdout


def test_an_installation_older_than_its_sources_is_one_line(tmp_path: Path) -> None:
    install(tmp_path, "hilbench", "")
    (tmp_path / "hilbench.py").unlink()
    done = hilbench_with(tmp_path, "check", "bench.yaml")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "what is installed lacks the command run" in done.stderr
