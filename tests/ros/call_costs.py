"""What a call of a node costs: beside the same question in Python, and beside a call that does nothing."""

import statistics
import time


def medians(*acts, number):
    """The median of each in milliseconds, in turns."""
    times = [[] for _ in acts]
    for _ in range(number):
        for act, found in zip(acts, times, strict=True):
            begin = time.perf_counter()
            act()
            found.append(time.perf_counter() - begin)
    return [statistics.median(found) * 1000 for found in times]


def show(costs):
    """Print the costs of calls by name: of the call, of Python, and of an empty call."""
    print()
    for name, (call, python, empty) in costs.items():
        print(
            f"{name}: {call:.2f} ms; in Python {python:.2f} ms, and an empty call {empty:.2f} ms: "
            f"{call / (python + empty):.2f} times"
        )
