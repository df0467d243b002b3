"""The page in a browser, beside the real daemon and a fake autopilot that flies."""

import base64
import contextlib
import json
import re
import socket
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from typer.testing import CliRunner

from ekf_companion.status import assets
from sim_autopilot.__main__ import app
from sim_autopilot.autopilot import Kind
from sim_autopilot.faults.fault import parse
from sim_autopilot.fly import fly, over, run
from tests.browser import chromium
from tests.daemon.test_daemon import Daemon, Open, free_port, plan
from tests.daemon.waiting import LIMIT


@contextlib.contextmanager
def flying(url, *faults):
    """Fly in time, with faults, until the context ends."""
    flight = Open(plan(600.0, boot=20.0, skip=6.0))
    wrong = [parse(one) for one in faults]

    async def body(link):
        await fly(flight, link, personality=Kind.PX4, faults=wrong, wait=LIMIT)

    thread = threading.Thread(target=lambda: run(over(url, body)))
    thread.start()
    try:
        yield flight
    finally:
        flight.land()
        thread.join()


@pytest.fixture
def ports():
    return free_port(), free_port(socket.SOCK_STREAM)


def start(folder, ports, http="", more=""):
    """Start the daemon on two ports, its link's and its page's."""
    folder.mkdir(exist_ok=True)
    port, http_port = ports
    config = f"http: {{port: {http_port}{http}}}\noutput: {{odometry: {{mode: always}}}}\n{more}"
    return Daemon(folder, "--link", f"udpin:127.0.0.1:{port}", config=config)


CHARTS = "[...document.querySelectorAll('.chart')]"
SPANNED = "Number(document.querySelector('.chart').dataset.seconds)"


def drawn(selector):
    """Return an expression that is another text once a canvas shows another picture."""
    return f"document.querySelector('{selector}').toDataURL().length + ''"


WIDEST = (
    (
        "stages",
        [
            *("aid", "fused", "deweighted", "gated", "suspect", "disturbed", "superseded"),
            "before alignment",
        ],
        [["position", "97923", "1234", "1234", "1234", "1234", "21234", "1234"]],
    ),
    (
        "rates",
        ["message", "asked", "got", "answer"],
        [
            ["POSITION_TARGET_GLOBAL_INT", "10", "9.9", "temporarily rejected"],
            [
                *("SCALED_PRESSURE", "10", "0.0"),
                "not offered; only autopilots whose inertial message has no pressure need it",
            ],
        ],
    ),
)
"""Tables of the page: name, head and rows."""


def cut_off(tab):
    """Return by how many pixels the widest tables are too wide for their places."""
    tab.value("void import('./page/view.js').then((view) => { window.view = view; })")
    tab.wait_for("window.view !== undefined")
    shown = "".join(f"window.view.showTable({json.dumps(one)[1:-1]});" for one in WIDEST)
    scrolls = "[...document.querySelectorAll('.scroll')]"
    measured = f"{scrolls}.map((one) => one.scrollWidth - one.clientWidth)"
    # In one turn: the page shows its own tables once a second
    return tab.value(f"(() => {{ {shown} return {measured}; }})()")


def test_the_page_shows_a_flight_and_the_loss_of_its_link(tmp_path, ports):
    """Connects, plots move, link loss is shown and recovered from, and the console has no error."""
    with chromium(tmp_path) as tab, flying(f"udpout:127.0.0.1:{ports[0]}") as flight:
        with start(tmp_path, ports) as daemon:
            daemon.wait_for("Status on")
            tab.show(1280, 900)
            tab.open(f"http://127.0.0.1:{ports[1]}/")
            tab.wait_for("document.querySelector('#link')?.textContent == 'live'")
            tab.wait_for("document.querySelector('#lat').textContent.startsWith('47.3')")
            pictures = {}
            for selector in ("#horizon", "#map", ".chart canvas"):
                pictures[selector] = tab.value(drawn(selector))
            for selector, before in pictures.items():
                tab.wait_for(f"{drawn(selector)} != '{before}'")
            tab.wait_for("document.querySelectorAll('#rates tbody tr').length > 3")
            # A message that is not offered, and that nobody needs, is no fault
            tab.wait_for("document.querySelectorAll('#rates td.bad').length == 0")
            # The widest tables that PX4 1.17 makes fit
            for width in (1024, 1160, 1210, 1440, 1280):
                tab.show(width, 900)
                assert cut_off(tab) == [0, 0], width
            tab.wait_for("document.querySelector('#events').textContent.includes('Estimate is OK')")
            assert tab.errors == []
            # A page that opens later shows what was before
            tab.open(f"http://127.0.0.1:{ports[1]}/")
            tab.wait_for("document.querySelector('#link')?.textContent == 'live'")
            tab.wait_for(f"{SPANNED} > performance.now() / 1000 + 2")
            titles = tab.value(f"{CHARTS}.map((one) => one.querySelector('h2').textContent)")
            assert len(titles) == 6
            spans = f"{CHARTS}.map((one) => Number(one.dataset.seconds))"
            assert len(set(tab.value(spans))) == 1, titles
            tab.wait_for("document.querySelector('#events').textContent.includes('Estimate is OK')")
            assert tab.errors == []
            # An autopilot that falls silent, and one that speaks again
            flight.land()
            tab.wait_for("document.body.classList.contains('old')")
            tab.wait_for("document.querySelector('.old-note').textContent.endsWith(' s old')")
            tab.wait_for(
                "document.querySelector('#link').textContent.startsWith('no samples for ')"
            )
            assert tab.value("document.querySelector('#link').className") == "badge bad"
            tab.wait_for(
                "/none for [0-9]+ s; the last was ok/.test(document.querySelector('#facts')"
                ".textContent)"
            )
            # A vehicle that is not heard is not said to be armed
            tab.wait_for(
                "/, silent for [0-9]+ s$/.test(document.querySelector('#vehicle').textContent)"
            )
            assert tab.text("#sigma-speed").endswith(" m/s")
            assert tab.value("document.querySelector('#facts dd.good')") is None
            # Nothing below contradicts the red words at the top, and only what is of now stands out
            assert tab.value("document.querySelector('#verdict').className") != "good"
            assert not tab.text("#health").startswith("ok")
            opacity = "getComputedStyle(document.querySelector('{}')).opacity"
            for part in ("#charts", "#counts td", "#facts dd:not(.bad):not(.now)"):
                assert float(tab.value(opacity.format(part))) < 0.5
            for part in ("#facts dd.bad", "#facts dd.now"):
                assert float(tab.value(opacity.format(part))) == 1.0
            tab.wait_for("document.querySelector('#rates td.bad')?.textContent == '0.0'")
            with flying(f"udpout:127.0.0.1:{ports[0]}"):
                tab.wait_for("!document.body.classList.contains('old')")
            assert tab.errors == []
        tab.wait_for("document.querySelector('#link').textContent.startsWith('no connection')")
        tab.wait_for("document.body.classList.contains('stale')")
        assert tab.text("#sentence") == "not known: nothing comes from the daemon"
        assert not re.search("armed|silent", tab.text("#vehicle"))
        with start(tmp_path, ports):
            tab.wait_for("document.querySelector('#link').textContent == 'no estimate yet'")
            assert tab.value("document.querySelector('#link').className") == "badge wait"
            tab.wait_for("!document.body.classList.contains('stale')")
            # That nothing answered is the browser's own line, which no page can prevent
            others = [one for one in tab.errors if "ERR_CONNECTION" not in str(one)]
            assert others == []


NOTE_TEXTS = """(() => {
  const draw = CanvasRenderingContext2D.prototype.fillText;
  window.texts = [];
  CanvasRenderingContext2D.prototype.fillText = function (text, ...rest) {
    window.texts.push(text);
    draw.call(this, text, ...rest);
  };
})()"""
"""Keeps what is written on canvases."""


@pytest.mark.campaign
def test_on_a_phone_everything_is_on_the_screen_and_times_of_day_have_their_hours(tmp_path, ports):
    """390 CSS pixels, of which the fonts take what they need."""
    flight = flying(f"udpout:127.0.0.1:{ports[0]}")
    with chromium(tmp_path) as tab, flight, start(tmp_path, ports) as daemon:
        daemon.wait_for("Status on")
        tab.show(390, 844, phone=True)
        tab.open(f"http://127.0.0.1:{ports[1]}/")
        tab.wait_for("document.querySelectorAll('#stages tbody tr').length > 3")
        tab.wait_for("/ok/.test(document.querySelector('#facts').textContent)")
        tab.value("document.querySelector('#link').textContent = 'no samples for 100 s'")
        lines = "document.querySelector('#link').getClientRects().length"
        height = "document.querySelector('{}').getBoundingClientRect()"
        assert tab.value(lines) == 1
        assert tab.value(f"{height.format('#link')}.height") < 28
        assert tab.value(f"{height.format('#link')}.top < {height.format('h1')}.bottom")
        subtitle = "document.querySelector('#vehicle')"
        assert tab.value(f"{subtitle}.scrollWidth <= {subtitle}.clientWidth")
        assert tab.value(f"{subtitle}.clientWidth") > 160
        for table in ("#counts", "#stages"):
            cells = f"[...document.querySelectorAll('{table} td, {table} th')]"
            right = "document.querySelector('.scroll').getBoundingClientRect().right"
            beyond = f"{cells}.filter((one) => one.getBoundingClientRect().right > {right} + 1)"
            assert tab.value(f"{beyond}.map((one) => one.textContent)") == []
        assert tab.value("document.documentElement.scrollWidth") == 390
        tab.value(NOTE_TEXTS)
        tab.wait_for("window.texts.some((one) => /^[0-9]{2}:[0-9]{2}:[0-9]{2}$/.test(one))")
        assert tab.value("window.texts.filter((one) => /^:/.test(one))") == []
        assert tab.errors == []


@pytest.mark.campaign
def test_a_compass_that_is_refused_is_on_the_page_and_in_its_events(tmp_path, ports):
    magnet = "mag-disturbance:start=4,duration=600,forward=0.3"
    flight = flying(f"udpout:127.0.0.1:{ports[0]}", magnet)
    with chromium(tmp_path) as tab, flight, start(tmp_path, ports) as daemon:
        daemon.wait_for("Compass refused, always or at times: the magnetic field is not")
        tab.open(f"http://127.0.0.1:{ports[1]}/")
        tab.wait_for("document.querySelector('#events')?.textContent.includes('Compass refused')")
        lately = "; lately refused: the magnetic field is not the Earth's"
        tab.wait_for(f'document.querySelector("#facts").textContent.includes("{lately}")')
        assert tab.errors == []


@pytest.mark.campaign
def test_a_fault_that_was_found_is_on_the_page(tmp_path, ports):
    jump = "baro-step:start=14,duration=600,height=20"
    flight = flying(f"udpout:127.0.0.1:{ports[0]}", jump)
    weighed = start(tmp_path, ports, more="weigh_faults: report\n")
    with chromium(tmp_path) as tab, flight, weighed as daemon:
        daemon.wait_for("Status on")
        tab.open(f"http://127.0.0.1:{ports[1]}/")
        for words in ("height: barometer (", "baro 100 %", "barometer 2"):
            tab.wait_for(f"document.querySelector('#facts')?.textContent.includes('{words}')")
        assert tab.errors == []


@contextlib.contextmanager
def viewing(log):
    """Run ``ekf-companion view`` over a log; yield its address."""
    command = [sys.executable, "-W", "error", "-m", "ekf_companion", "view", str(log)]
    with subprocess.Popen([*command, "--no-browser"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline().startswith(("good", "fair", "poor"))
        try:
            yield process.stdout.readline().split()[0]
        finally:
            process.terminate()
            assert process.wait(LIMIT) == 0


def test_a_log_is_shown_with_a_slider_and_both_estimates(tmp_path):
    log = tmp_path / "flight.tlog"
    options = ["generate", "--duration", "30", "--scenario", "figure-eight", "-o", str(log)]
    options += ["--fault", "mag-disturbance:start=20,duration=8,forward=0.3"]
    assert CliRunner().invoke(app, options).exit_code == 0
    with viewing(log) as url, chromium(tmp_path) as tab:
        tab.show(1280, 900)
        tab.open(url)
        tab.wait_for("document.querySelector('#link')?.textContent == 'log'")
        assert tab.text("#sentence").startswith(("good: ", "fair: "))
        before = [tab.text(one) for one in ("#clock", "#roll", "#autopilot-roll")]
        move = "slider.value = 0.7 * slider.max; slider.dispatchEvent(new Event('input'))"
        tab.value(f"(() => {{ const slider = document.querySelector('#time'); {move} }})()")
        after = [tab.text(one) for one in ("#clock", "#roll", "#autopilot-roll")]
        assert all(one != other for one, other in zip(before, after, strict=True))
        assert tab.value("document.querySelectorAll('.chart').length") >= 10
        # A disturbed field was refused by no gate
        assert re.search(r"[0-9]+ disturbed", tab.text("#stages"))
        assert "heading disturbed" in tab.text("#charts")
        # At its begin no position is known, and the whole track is
        tab.value(NOTE_TEXTS)
        move = "slider.value = 0; slider.dispatchEvent(new Event('input'))"
        tab.value(f"(() => {{ const slider = document.querySelector('#time'); {move} }})()")
        assert tab.text("#lat").strip() in ("", "\u2013")
        assert "no position yet" not in tab.value("window.texts")
        tab.value("document.querySelector('#play').click()")
        tab.wait_for("!document.querySelector('#clock').textContent.startsWith('0.0')")
        assert tab.errors == []


TRACK = """void import('./page/track.js').then(({ Track }) => {
  const track = new Track("ours");
  const along = (from, to) => { for (let x = from; x < to; x++) track.add([x, 0]); };
  along(0, 5);
  track.add(null);
  track.add(null);
  along(40, 45);
  const pieces = track.points.map((one) => one && one[0]);
  for (let i = 0; i < 20000; i++) track.add(i % 100 ? [i, 0] : null);
  const ends = track.points.filter((one) => one === null).length;
  window.found = [pieces, track.points.length, ends, track.points[0] !== null];
})"""


def test_a_track_ends_where_nothing_comes_also_when_it_is_thinned(tmp_path, ports):
    with chromium(tmp_path) as tab, start(tmp_path, ports) as daemon:
        daemon.wait_for("Status on")
        tab.open(f"http://127.0.0.1:{ports[1]}/")
        tab.wait_for("document.querySelector('#link')?.textContent == 'no estimate yet'")
        # What is empty says so
        tab.value(NOTE_TEXTS)
        tab.wait_for("window.texts.includes('no position yet')")
        tab.wait_for("window.texts.includes('no attitude')")
        assert tab.value("document.querySelector('#facts dd.bad')") is None
        tab.value(TRACK)
        pieces, count, ends, begins = tab.wait_for("window.found")
        assert pieces == [0, 1, 2, 3, 4, None, 40, 41, 42, 43, 44]
        assert 2000 < count <= 6000
        assert 100 < ends <= 202
        assert begins
        assert tab.errors == []


@contextlib.contextmanager
def serving_tiles():
    """Serve a picture at every address of a tile; yield the port, and what was asked for."""
    asked = []
    pixel = base64.b64decode(
        "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAEhQGAhKmMIQAAAABJRU5ErkJggg=="
    )

    class Tiles(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_response(200)
            self.send_header("Content-Type", "image/png")
            self.send_header("Content-Length", str(len(pixel)))
            self.end_headers()
            self.wfile.write(pixel)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Tiles) as server:
        threading.Thread(target=server.serve_forever).start()
        try:
            yield server.server_port, asked
        finally:
            server.shutdown()


def test_a_map_lies_under_the_track_where_tiles_are_configured(tmp_path, ports):
    flight = flying(f"udpout:127.0.0.1:{ports[0]}")
    with chromium(tmp_path) as tab, flight, serving_tiles() as (port, asked):
        tiles = (
            f'"http://127.0.0.1:{port}/{{z}}/{{x}}/{{y}}.png", tiles_credit: "(c) <us> & \'you\'"'
        )
        with start(tmp_path, ports, f", tiles: {tiles}") as daemon:
            daemon.wait_for("Status on")
            tab.open(f"http://127.0.0.1:{ports[1]}/")
            tab.wait_for("document.querySelector('#lat')?.textContent.startsWith('47.3')")
            tab.value(NOTE_TEXTS)
            tab.wait_for("window.texts.includes(\"(c) <us> & 'you'\")")
            tab.value(
                "(() => { const draw = CanvasRenderingContext2D.prototype.drawImage;"
                "CanvasRenderingContext2D.prototype.drawImage = function (...of) {"
                "window.drawn = of; draw.apply(this, of); }; })()"
            )
            # A square, and larger than 256 pixels while the finest of the server is too coarse
            _, _, width, height = tab.wait_for("window.drawn?.slice(1)")
            assert width > 120
            assert height == pytest.approx(width, rel=0.02)
            assert tab.errors == []
    columns = {int(one.split("/")[2]) / 2 ** int(one.split("/")[1]) for one in asked}
    assert all(abs(360.0 * one - 180.0 - 8.55) < 0.2 for one in columns)
    assert all(int(one.split("/")[1]) <= 18 for one in asked)


def test_no_other_server_is_asked_for_anything_unless_tiles_are_configured():
    page = assets.index("live").decode()
    assert 'data-tiles=""' in page
    hostile = assets.index("live", "https://a.b/{z}", '"><script>alert(1)</script>').decode()
    assert "<script>alert" not in hostile


TAPE = """(() => {
  const draw = CanvasRenderingContext2D.prototype.fillText;
  window.cut = [];
  window.written = 0;
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    const half = this.measureText(text).width / 2;
    const isTape = this.canvas.id === "horizon" && this.textAlign === "center" && y > 200;
    if (isTape) window.written++;
    if (isTape && (x - half < 0 || x + half > this.canvas.clientWidth)) window.cut.push(text);
    draw.call(this, text, x, y);
  };
})()"""
"""Keeps the labels of the heading that the edge of the horizon cuts."""


def test_no_label_of_the_heading_is_cut(tmp_path, ports):
    with chromium(tmp_path) as tab, start(tmp_path, ports) as daemon:
        daemon.wait_for("Status on")
        tab.show(390, 844, phone=True)
        tab.open(f"http://127.0.0.1:{ports[1]}/")
        tab.wait_for("document.querySelector('#link')?.textContent == 'no estimate yet'")
        tab.value(TAPE)
        tab.value(
            "void import('./page/horizon.js').then(({ drawHorizon }) => {"
            "for (let yaw = 0; yaw < 360; yaw++)"
            "drawHorizon({ roll_deg: 0, pitch_deg: 0, heading_deg: yaw }); window.done = true; })"
        )
        tab.wait_for("window.done")
        assert tab.value("window.written") > 1000
        assert tab.value("window.cut") == []


def test_without_the_charting_library_the_page_says_so_and_works(monkeypatch):
    found = assets.asset

    def absent(name):
        return None if name.startswith("uPlot") else found(name)

    monkeypatch.setattr(assets, "asset", absent)
    page = assets.index.__wrapped__("live").decode()
    assert assets.NO_CHARTS in page
    assert "uPlot.js" not in page
    assert "main.js" in page


def test_all_that_the_page_loads_is_in_the_package():
    page = assets.index("live").decode()
    assert assets.NO_CHARTS not in page
    loaded = set(re.findall(r'(?:src|href)="page/([^"]+)"', page))
    for name in sorted(loaded):
        if name.endswith(".js") and not name.startswith("uPlot"):
            loaded |= imported(name)
    assert {"main.js", "live.js", "page.css", "uPlot.js"} <= loaded
    assert all(assets.asset(name) for name in loaded)
    assert assets.asset("uPlot.LICENSE.txt")
    assert "://" not in page.replace("http://www.w3.org", "")


def imported(name, seen=frozenset()):
    """Return the modules that a module imports, and theirs."""
    text = assets.asset(name).body.decode()
    found = set(re.findall(r'from "\./([^"]+)"', text)) - seen
    return found.union(*(imported(one, seen | found) for one in found)) if found else found


@pytest.mark.parametrize("name", ["../assets.py", "..", "", "absent.js", "%2e%2e/live.py"])
def test_no_other_file_is_an_asset(name):
    assert assets.asset(name) is None
