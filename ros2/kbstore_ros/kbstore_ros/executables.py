"""What `ros2 run kbstore_ros` finds: the commands `kbstore ros plansys2` and `kbstore ros record`.

The store is named by the environment variables KBSTORE_URL and KBSTORE_KB, or by options before ``--ros-args``.
"""

import sys

try:
    from kbstore.cli.app import app
except ImportError as error:
    raise SystemExit(
        f"kbstore cannot be imported by {sys.executable} ({error}); install it there "
        f"({sys.executable} -m pip install kbstore), or activate the virtual environment that has it"
    ) from None


def experts() -> None:
    """PlanSys2's problem expert and domain expert, answered from a store."""
    _run("plansys2")


def record() -> None:
    """The recorder beside a running PlanSys2."""
    _run("record")


def _run(command: str) -> None:
    app(["ros", command, *sys.argv[1:]], prog_name="kbstore")
