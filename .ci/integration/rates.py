"""How often messages come, by the vehicle's own clock."""

# Fewer intervals than these say nothing of an average.
INTERVALS = 40


class Meter:
    """Takes messages in the order in which they come. One without a time of its own has that of the one before it."""

    def __init__(self):
        self.now = None
        self.times = {}

    def take(self, kind, fields):
        """`fields` are the message's, by name."""
        if "time_boot_ms" in fields:
            self.now = fields["time_boot_ms"] * 1000
        elif kind in ("GPS_RAW_INT", "HOME_POSITION"):
            self.now = fields["time_usec"]
        if self.now:
            self.times.setdefault(kind, []).append(self.now)

    def has_enough(self, kinds):
        return all(len(self.times.get(kind, [])) > INTERVALS + 2 for kind in kinds)

    def interval(self, kind):
        """The mean in us, of the last ones: what came first may have been on its way when the interval was set."""
        times = self.times[kind][-INTERVALS - 1 :]
        return (times[-1] - times[0]) / (len(times) - 1)
