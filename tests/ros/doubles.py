"""Messages of ROS 1 without ROS: objects with the fields and defaults of the definitions in this directory."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

HERE = Path(__file__).parent

PLAIN = {"bool": False, "string": "", "float64": 0.0} | dict.fromkeys(("uint8", "int8", "uint32", "int32"), 0)


@cache
def fields(name):
    """The fields of a message, or of the request or response of a service: pairs of a name and a type."""
    kind, _, part = name.rpartition("Re")
    service = next(HERE.glob(f"*/srv/{kind}.srv"), None) if part in ("quest", "sponse") else None
    if service is not None:
        text = service.read_text().partition("---\n")[0 if part == "quest" else 2]
    else:
        text = next(HERE.glob(f"*/msg/{name}.msg")).read_text()
    lines = [line.split() for line in text.splitlines() if line.strip() and "=" not in line]
    return [(field, type_name) for type_name, field in lines]


def make(name):
    """A message with the defaults of ROS; it takes no attribute that its definition lacks."""
    message = _kind(name)()
    for field, type_name in fields(name):
        setattr(message, field, _default(type_name))
    return message


@cache
def _kind(name):
    return type(name, (), {"__slots__": [field for field, _ in fields(name)]})


def _default(type_name):
    if type_name.endswith("[]"):
        return []
    if type_name in ("time", "duration"):
        return SimpleNamespace(secs=0, nsecs=0)
    return PLAIN[type_name] if type_name in PLAIN else make(type_name.rpartition("/")[2])


def given(name, /, **values):
    """A message with some fields set."""
    message = make(name)
    for field, value in values.items():
        setattr(message, field, value)
    return message
