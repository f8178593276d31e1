"""Message rates, measured by the vehicle's clock."""

import math
import time

# The number of intervals for a mean, and its maximum relative error.
INTERVALS = 40
TOLERANCE = 0.05


class Meter:
    """Takes messages in the order of reception. A message without a timestamp counts with the time of the previous one. Of
    several batteries only the first counts.
    """

    def __init__(self):
        self.now = None
        self.times = {}

    def take(self, kind, fields):
        """Takes a message; `fields` are its fields by name."""
        if "time_boot_ms" in fields:
            self.now = fields["time_boot_ms"] * 1000
        elif kind in ("GPS_RAW_INT", "HOME_POSITION"):
            self.now = fields["time_usec"]
        if self.now and not (kind == "BATTERY_STATUS" and fields.get("id")):
            self.times.setdefault(kind, []).append(self.now)

    def errors(self, wanted):
        """Returns the relative errors of the last intervals' means, by message. `wanted` are the right intervals (us). Until there are
        enough messages, all errors are infinite. The first messages may have been in flight when the interval was set."""
        if any(len(self.times.get(kind, [])) <= INTERVALS + 2 for kind in wanted):
            return dict.fromkeys(wanted, math.inf)
        means = {kind: (self.times[kind][-1] - self.times[kind][-1 - INTERVALS]) / INTERVALS for kind in wanted}
        return {kind: means[kind] / interval - 1 for kind, interval in wanted.items()}


def steady_gaps(next_time, count, is_right, timeout=60):
    """Calls `next_time`, which waits for a periodic message and returns its time, until all of the last gaps are right, which are `count`
    in a row. Returns these gaps.

    On a busy machine the vehicle or this program may not run for a moment.
    """
    times, deadline = [], time.monotonic() + timeout
    while True:
        times.append(next_time())
        gaps = [after - before for before, after in zip(times, times[1:])][-count:]
        if len(gaps) == count and is_right(gaps):
            return gaps
        assert time.monotonic() < deadline, f"the gaps between the messages are not right: {gaps}"


def settled_errors(measure, wanted, timeout=60):
    """Calls `measure`, which takes more messages and returns the meter, until all means are within the tolerance. Returns the largest
    error with its message.

    On a busy machine the vehicle may not run for a moment. It then sends a message late, or leaves one out.
    """
    deadline = time.monotonic() + timeout
    while True:
        errors = measure().errors(wanted)
        worst = max(errors, key=lambda kind: abs(errors[kind]))
        if abs(errors[worst]) < TOLERANCE:
            return errors[worst], worst
        assert time.monotonic() < deadline, f"the rates differ from the requested ones: {errors}"
