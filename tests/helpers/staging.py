"""Work for processes that holds a folder's lock for a moment."""

import time
from pathlib import Path

from ppmcal.store.transaction import staged


def stay(folder: str, item: int) -> int:
    """Stage a folder of its own, and wait in it."""
    with staged(Path(folder, str(item)), "test") as stage:
        stage.new.mkdir()
        (stage.new / "half").write_text("half")
        time.sleep(0.02)
    return item
