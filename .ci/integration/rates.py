"""Message rates, measured by the vehicle's clock."""

# The number of intervals for a mean.
INTERVALS = 40


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

    def has_enough(self, kinds):
        return all(len(self.times.get(kind, [])) > INTERVALS + 2 for kind in kinds)

    def interval(self, kind):
        """Returns the mean of the last intervals (us). The first messages may have been in flight when the interval was set."""
        times = self.times[kind][-INTERVALS - 1 :]
        return (times[-1] - times[0]) / (len(times) - 1)
