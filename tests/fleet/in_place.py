"""An executor for tests that starts no process."""

from pathlib import Path

from ekf_companion.fleet.executor import KILLED, Lost


class InPlace:
    """An executor without processes, which may lose an item, or end."""

    def __init__(self, lost="", most=99):
        self.asked, self._lost, self._most = [], lost, most

    def run(self, task, items):
        for item in items:
            name = getattr(item, "name", "")
            if self._lost and name.endswith(self._lost):
                yield item, Lost(KILLED)
                continue
            if name:
                if len(self.asked) == self._most:
                    raise KeyboardInterrupt
                self.asked.append(Path(name).name)
            yield item, task(item)
