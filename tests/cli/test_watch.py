"""Keys of a terminal: several that come together, and one that comes in parts."""

import pytest

from ekf_companion.cli.watch import Keys, Window

UP, DOWN = b"\x1b[A", b"\x1b[B"


@pytest.mark.parametrize(
    ("parts", "keys"),
    [
        ([b"jjj"], [b"j", b"j", b"j"]),
        ([DOWN + DOWN + UP], [DOWN, DOWN, UP]),
        ([DOWN * 30], [DOWN] * 30),
        ([b"jjq"], [b"j", b"j", b"q"]),
        ([b"\x1b", b"[B"], [DOWN]),
        ([b"\x1b[", b"B"], [DOWN]),
        ([b"\x1b[6", b"~ "], [b"\x1b[6~", b" "]),
        # Application mode, a key with Ctrl, Alt and a letter, Escape and then q
        ([b"\x1bOB"], [DOWN]),
        ([b"\x1b[1;5Aq"], [b"\x1b[1;5A", b"q"]),
        ([b"\x1bq"], [b"\x1b", b"q"]),
        ([b"\x1b", b"q"], [b"\x1b", b"q"]),
        # No key sends this; what follows is heard
        ([b"\x1b[" + b"1" * 64, b"\x1b[B"], None),
    ],
)
def test_keys_are_found_however_they_come(parts, keys):
    found = Keys()
    heard = [key for part in parts for key in found.feed(part)]
    assert heard == keys if keys is not None else heard[-1] == DOWN


def test_a_window_moves_by_each_of_them():
    from rich.console import Console

    window = Window()
    window.show("\n".join(map(str, range(200))))
    console = Console(width=40, height=11)
    with console.capture():
        console.print(window)
    for key in Keys().feed(b"jj" + DOWN * 3):
        window.scroll(key)
    with console.capture() as shown:
        console.print(window)
    assert "lines 6 to 15 of 200" in shown.get()
