"""The event loop of asyncio on the simulated machine."""

import asyncio

from tests.simulation.machine import Thread


class SimLoop(asyncio.SelectorEventLoop):
    """An event loop whose time, selector, signals and threads are those of a simulated process."""

    def __init__(self, kernel, spawning):
        self._machine, self._spawning = kernel.machine, spawning
        super().__init__(kernel.selector())

    def time(self):
        return 1e-9 * self._machine.look_ns()

    def _make_self_pipe(self):
        self._internal_fds = 0
        self._ssock = self._csock = None

    def _close_self_pipe(self):
        pass

    def _write_to_self(self):
        self._selector.wake()

    def add_signal_handler(self, sig, callback, *args):
        self._spawning.handle(sig, lambda *_: self.call_soon_threadsafe(callback, *args))

    def remove_signal_handler(self, sig):
        self._spawning.handle(sig, 0)
        return True

    def run_in_executor(self, executor, func, *args):
        future = self.create_future()

        def work():
            try:
                result = func(*args)
            except BaseException as error:  # noqa: BLE001  # the future carries it
                self.call_soon_threadsafe(_settle, future, None, error)
            else:
                self.call_soon_threadsafe(_settle, future, result, None)

        Thread(self._machine.process, work, "executor")
        return future

    async def shutdown_default_executor(self):
        pass


def _settle(future, result, error):
    if future.done():
        return
    if error is None:
        future.set_result(result)
    else:
        future.set_exception(error)


class SimPolicy(asyncio.DefaultEventLoopPolicy):
    """Makes event loops of the simulated machine."""

    def __init__(self, kernel, spawning):
        super().__init__()
        self._kernel, self._spawning = kernel, spawning

    def new_event_loop(self):
        return SimLoop(self._kernel, self._spawning)
