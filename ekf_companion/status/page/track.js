/** The track over ground, with the ellipse that encloses 95 %, and the autopilot's track. */

import { $, colours, isKnown, open, put } from "./format.js";
import { drawTiles, hasTiles } from "./tiles.js";

const RADIUS = 6371008.8;
const DEGREE = (Math.PI / 180) * RADIUS;
const KEPT = 6000;
/** Two degrees of freedom: chi-square 5.991. */
const SCALE_95 = Math.sqrt(5.991);

/** Points of one track, metres east and north of a place that both tracks share; null ends a piece. */
export class Track {
  constructor(name) {
    this.name = name;
    this.points = [];
    this.past = []; // one a second, from before the page opened: dots, as a line would cut corners
  }

  /** Add a position, less what moves no pixel; null: from here to the next one no line is drawn. */
  add(point) {
    const last = this.points.at(-1);
    if (point ? last && Math.hypot(last[0] - point[0], last[1] - point[1]) < 0.1 : !last) return;
    this.points.push(point);
    if (this.points.length > KEPT) this.points = halve(this.points);
  }
}

/** Every other point, and the ends of the pieces; of too many pieces the newest. */
function halve(points) {
  const kept = points.filter((point, i) => i % 2 === 0 || !point || !points[i - 1] || !points[i + 1]);
  return kept.length > 0.9 * KEPT ? kept.slice(-KEPT / 2) : kept;
}

export class Map {
  constructor() {
    this.tracks = { autopilot: new Track("autopilot"), ours: new Track("ours") };
    this.isFollowing = false;
    $("follow").addEventListener("click", () => {
      this.isFollowing = !this.isFollowing;
      $("follow").setAttribute("aria-pressed", String(this.isFollowing));
      this.draw();
    });
  }

  /** East and north of the first position, m; null if it is not known. */
  place(lat, lon) {
    if (!isKnown(lat) || !isKnown(lon)) return null;
    this.origin ??= [lat, lon];
    const [lat0, lon0] = this.origin;
    return [(lon - lon0) * DEGREE * Math.cos((lat0 * Math.PI) / 180), (lat - lat0) * DEGREE];
  }

  /** Show where we are: "live"; "old", where ours stands still as nothing comes; "log", whose tracks are filled. */
  show(ours, autopilot, kind) {
    this.now = ours && this.place(ours.lat_deg, ours.lon_deg);
    this.beside = autopilot && this.place(autopilot.lat_deg, autopilot.lon_deg);
    this.sample = ours;
    if (kind !== "log") {
      this.tracks.ours.add(kind === "old" ? null : this.now);
      this.tracks.autopilot.add(this.beside);
    }
    this.draw();
  }

  /** Draw no line from where they are to what comes next. */
  lift(...names) {
    names.forEach((name) => this.tracks[name].add(null));
  }

  /** Show where both were before the page opened. */
  addPast(rows) {
    for (const [name, of] of [["ours", (row) => row], ["autopilot", (row) => row.autopilot]]) {
      const before = new Track(name);
      for (const one of rows.map(of)) {
        const point = one && this.place(one.lat_deg, one.lon_deg);
        if (point) before.add(point);
      }
      this.tracks[name].past = before.points;
    }
  }

  /** Middle and pixels per metre of the part that is shown. */
  frame(width, height) {
    const sigma = Math.sqrt(Math.max(this.sample?.ellipse_m2?.[0] ?? 1, this.sample?.ellipse_m2?.[2] ?? 1));
    const least = Math.max(4 * sigma * SCALE_95, 6);
    if (this.isFollowing && this.now) {
      return { middle: this.now, scale: Math.min(width, height) / least };
    }
    let [west, south, east, north] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const [x, y] of Object.values(this.tracks).flatMap(({ past, points }) => [...past, ...points]).filter(Boolean)) {
      west = Math.min(west, x);
      east = Math.max(east, x);
      south = Math.min(south, y);
      north = Math.max(north, y);
    }
    const middle = west > east ? [0, 0] : [(west + east) / 2, (south + north) / 2];
    const [across, up] = [Math.max(east - west, least), Math.max(north - south, least)];
    return { middle, scale: 0.86 * Math.min(width / across, height / up) };
  }

  /** Draw the map under what is shown, and again when more of it has come. */
  drawMap(c, at, [east, north], scale, width, height) {
    const [lat0, lon0] = this.origin;
    const cos = Math.cos((lat0 * Math.PI) / 180);
    const placeOf = (x, y) => [lat0 + y / DEGREE, lon0 + x / (DEGREE * cos)];
    const [right, up] = [width / 2 / scale, height / 2 / scale];
    const again = () => {
      this.due ??= requestAnimationFrame(() => {
        this.due = undefined;
        this.draw();
      });
    };
    drawTiles(c, placeOf(east - right, north - up), placeOf(east + right, north + up), scale, width, height,
      (lat, lon) => at(this.place(lat, lon)), again);
  }

  draw() {
    const { context: c, width, height } = open($("map"));
    if (width < 20) return;
    const colour = colours();
    const { middle, scale } = this.frame(width, height);
    const at = ([x, y]) => [width / 2 + (x - middle[0]) * scale, height / 2 - (y - middle[1]) * scale];
    const step = niceStep(80 / scale);
    if (hasTiles && this.origin) this.drawMap(c, at, middle, scale, width, height);
    drawGrid(c, colour, width, height, middle, scale, step);
    put("scale", `grid ${step >= 1000 ? `${step / 1000} km` : `${step} m`}, ellipse 95 %`, "note");
    for (const name of ["autopilot", "ours"]) {
      const { past, points } = this.tracks[name];
      past.forEach((point) => dot(c, at(point), colour[name], 1.5));
      c.strokeStyle = colour[name];
      c.lineWidth = name === "ours" ? 2 : 1.6;
      c.setLineDash(name === "ours" ? [] : [6, 4]);
      drawPieces(c, points, at);
    }
    c.setLineDash([]);
    if (this.beside) dot(c, at(this.beside), colour.autopilot);
    if (this.now) {
      drawEllipse(c, colour, at(this.now), this.sample.ellipse_m2, scale);
      drawArrow(c, colour, at(this.now), this.sample.heading_deg);
    } else if (!Object.values(this.tracks).some(({ past, points }) => past.length || points.length)) {
      c.fillStyle = colour.dim;
      c.textAlign = "center";
      c.font = "13px system-ui, sans-serif";
      c.fillText("no position yet", width / 2, height / 2);
    }
  }
}

/** One line for each piece; of a piece of one point a dot. */
function drawPieces(c, points, at) {
  c.lineCap = "round";
  c.beginPath();
  points.forEach((point, i) => {
    if (!point) return;
    if (!points[i - 1]) c.moveTo(...at(point));
    c.lineTo(...at(point));
  });
  c.stroke();
}

function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((one) => one * power).find((one) => one >= least);
}

function drawGrid(c, colour, width, height, middle, scale, step) {
  c.strokeStyle = colour.line;
  c.lineWidth = 1;
  c.beginPath();
  for (let k = Math.ceil((middle[0] - width / 2 / scale) / step); ; k++) {
    const x = width / 2 + (k * step - middle[0]) * scale;
    if (x > width) break;
    c.moveTo(x, 0);
    c.lineTo(x, height);
  }
  for (let k = Math.ceil((middle[1] - height / 2 / scale) / step); ; k++) {
    const y = height / 2 - (k * step - middle[1]) * scale;
    if (y < 0) break;
    c.moveTo(0, y);
    c.lineTo(width, y);
  }
  c.stroke();
  c.fillStyle = colour.dim;
  c.font = "11px system-ui, sans-serif";
  c.textAlign = "right";
  c.fillText("N \u2191", width - 6, 14);
}

function drawEllipse(c, colour, [x, y], covariance, scale) {
  const [nn, ne, ee] = covariance ?? [];
  if (!isKnown(nn) || !isKnown(ee)) return;
  const [mean, half] = [(nn + ee) / 2, Math.hypot((nn - ee) / 2, ne)];
  const long = Math.sqrt(mean + half) * SCALE_95 * scale;
  const short = Math.sqrt(Math.max(mean - half, 0)) * SCALE_95 * scale;
  c.save();
  c.translate(x, y);
  // Azimuth of the long axis, from north clockwise
  c.rotate(0.5 * Math.atan2(2 * ne, nn - ee) - Math.PI / 2);
  c.beginPath();
  c.ellipse(0, 0, Math.max(long, 1), Math.max(short, 1), 0, 0, 2 * Math.PI);
  c.globalAlpha = 0.18;
  c.fillStyle = colour.ours;
  c.fill();
  c.globalAlpha = 0.9;
  c.strokeStyle = colour.ours;
  c.lineWidth = 1.2;
  c.stroke();
  c.restore();
}

function drawArrow(c, colour, [x, y], heading) {
  if (!isKnown(heading)) return dot(c, [x, y], colour.ours);
  c.save();
  c.translate(x, y);
  c.rotate((heading * Math.PI) / 180);
  c.fillStyle = colour.ours;
  c.strokeStyle = colour.card;
  c.beginPath();
  c.moveTo(0, -10);
  c.lineTo(6, 7);
  c.lineTo(0, 3);
  c.lineTo(-6, 7);
  c.closePath();
  c.fill();
  c.stroke();
  c.restore();
  return undefined;
}

function dot(c, [x, y], colour, radius = 4) {
  c.fillStyle = colour;
  c.beginPath();
  c.arc(x, y, radius, 0, 2 * Math.PI);
  c.fill();
}
