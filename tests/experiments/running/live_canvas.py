"""A toolkit for matplotlib without a desktop, for tests: `MPLBACKEND=module://...`.

Each drawing goes to the file that LIVE_PICTURE names, with the texts in it beside it. The window is
closed after as many drawings as LIVE_CLOSE says, as a user would.
"""

import os
import time
from pathlib import Path
from typing import ClassVar

from matplotlib.backend_bases import FigureManagerBase, TimerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text


class Timer(TimerBase):
    def _timer_start(self):
        Manager.timers.append(self)


class Manager(FigureManagerBase):
    timers: ClassVar = []
    open = True
    drawn = 0

    def destroy(self, *args):
        Manager.open = False

    @classmethod
    def pyplot_show(cls, *, block=None):
        while cls.open:
            for timer in cls.timers:
                timer._on_timer()
            time.sleep(0.01)


class FigureCanvas(FigureCanvasAgg):
    manager_class = Manager

    def new_timer(self, interval=None, callbacks=None):
        return Timer(interval, callbacks)

    def draw_idle(self, *args, **kwargs):
        picture = Path(os.environ["LIVE_PICTURE"])
        self.figure.savefig(picture.with_suffix(".new.png"))
        texts = [text.get_text() for text in self.figure.findobj(Text)]
        picture.with_suffix(".new.txt").write_text("\n".join(texts))
        for suffix in (".txt", ".png"):
            picture.with_suffix(f".new{suffix}").replace(picture.with_suffix(suffix))
        Manager.drawn += 1
        if Manager.drawn == int(os.environ.get("LIVE_CLOSE", 0)):
            Manager.open = False


FigureManager = Manager
