"""Fake link and fake clock for tests of the loop."""

from piezod.transport import ExchangeResult, Reading


class FakeClock:
    """Clock that advances by one period per `wait`."""

    def __init__(self, period_ns=1_000_000):
        self.period_ns = period_ns
        self.tick = self.missed = self.missed_in_a_row = self.lateness_ns = 0

    def start(self):
        pass

    def now_ns(self):
        return self.tick * self.period_ns

    def time_left_ns(self):
        return self.period_ns

    def sleep_until_before(self, left_ns):
        pass

    def wait(self):
        self.tick += 1


class FakeLink:
    """Force = 2 N/V x voltage, one exchange later; lists every voltage written."""

    description = "fake"
    last_exception = stale_bytes = 0
    hint = ""
    output_confirmed = False
    supervised = 0
    holds_command = False

    def __init__(self, plant=None):
        self.plant = plant or (lambda voltage_V: 2.0 * voltage_V)
        self.reading = Reading()
        self.reading.force_N = 0.0
        self.reading.voltage_readback_V = 0.0
        self.written_V = 0.0
        self.counts = [0] * len(ExchangeResult)
        self.voltages = []
        self.fails = lambda _: False
        self.exchanges = 0

    def exchange(self, voltage_V):
        self.exchanges += 1
        if self.fails(self.exchanges):
            return ExchangeResult.TIMEOUT
        self.reading.force_N = self.plant(self.written_V)
        self.reading.voltage_readback_V = self.written_V
        self.written_V = voltage_V
        self.voltages.append(voltage_V)
        return ExchangeResult.OK

    def poll(self):
        return ExchangeResult.OK
