/** The artificial horizon: ours as the picture, the autopilot's as a dashed line and a mark. */

import { $, colours, isKnown, open, turn } from "./format.js";

const radians = Math.PI / 180;

export function drawHorizon(ours, autopilot) {
  const { context: c, width, height } = open($("horizon"));
  const colour = colours();
  const tape = 34;
  const [x, y, r] = [width / 2, (height - tape) / 2, Math.min(width / 2, (height - tape) / 2) - 3];
  if (r < 10) return;
  const perDegree = r / 40;
  c.save();
  c.beginPath();
  c.arc(x, y, r, 0, 2 * Math.PI);
  c.clip();
  if (isKnown(ours?.roll_deg)) {
    c.save();
    c.translate(x, y);
    c.rotate(-ours.roll_deg * radians);
    drawWorld(c, colour, r, ours.pitch_deg * perDegree, perDegree);
    c.restore();
  } else {
    c.fillStyle = colour.line;
    c.fillRect(0, 0, width, height);
    c.fillStyle = colour.dim;
    c.font = "13px system-ui, sans-serif";
    c.textAlign = "center";
    c.fillText("no attitude", x, y + 0.4 * r);
  }
  if (isKnown(autopilot?.roll_deg)) {
    c.save();
    c.translate(x, y);
    c.rotate(-autopilot.roll_deg * radians);
    c.strokeStyle = colour.autopilot;
    c.setLineDash([9, 6]);
    c.lineWidth = 2.5;
    line(c, -2 * r, autopilot.pitch_deg * perDegree, 2 * r, autopilot.pitch_deg * perDegree);
    c.restore();
  }
  c.restore();
  drawRoll(c, colour, x, y, r, ours);
  drawAircraft(c, x, y, r);
  drawHeading(c, colour, width, height, tape, ours?.heading_deg, autopilot?.heading_deg);
}

function line(c, x1, y1, x2, y2) {
  c.beginPath();
  c.moveTo(x1, y1);
  c.lineTo(x2, y2);
  c.stroke();
}

function drawWorld(c, colour, r, down, perDegree) {
  c.fillStyle = colour.sky;
  c.fillRect(-2 * r, -8 * r, 4 * r, 8 * r + down);
  c.fillStyle = colour.earth;
  c.fillRect(-2 * r, down, 4 * r, 8 * r);
  c.strokeStyle = c.fillStyle = "#fff";
  c.lineWidth = 2;
  line(c, -2 * r, down, 2 * r, down);
  c.lineWidth = 1.2;
  c.font = "10px system-ui, sans-serif";
  c.textBaseline = "middle";
  for (let pitch = -90; pitch <= 90; pitch += 5) {
    const at = down - pitch * perDegree;
    if (pitch === 0 || Math.abs(at) > r) continue;
    const half = pitch % 10 ? r * 0.1 : r * 0.24;
    line(c, -half, at, half, at);
    // A number that the circle would cut is left out
    if (pitch % 10 || Math.hypot(Math.abs(at) + 5, half + 18) > r) continue;
    c.textAlign = "right";
    c.fillText(Math.abs(pitch), -half - 4, at);
    c.textAlign = "left";
    c.fillText(Math.abs(pitch), half + 4, at);
  }
}

function drawRoll(c, colour, x, y, r, ours) {
  c.save();
  c.translate(x, y);
  c.strokeStyle = colour.ink;
  c.lineWidth = 1.5;
  c.beginPath();
  c.arc(0, 0, r, 0, 2 * Math.PI);
  c.stroke();
  c.strokeStyle = "#fff";
  for (const degrees of [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60]) {
    c.save();
    c.rotate(degrees * radians);
    line(c, 0, -r + 1, 0, -r + (degrees % 30 ? 6 : 10));
    c.restore();
  }
  if (isKnown(ours?.roll_deg)) {
    c.rotate(-ours.roll_deg * radians);
    c.fillStyle = "#ffd23f";
    c.beginPath();
    c.moveTo(0, -r + 11);
    c.lineTo(-6, -r + 21);
    c.lineTo(6, -r + 21);
    c.fill();
  }
  c.restore();
}

function drawAircraft(c, x, y, r) {
  c.save();
  c.translate(x, y);
  c.strokeStyle = "#ffd23f";
  c.lineWidth = 3;
  c.lineCap = c.lineJoin = "round";
  c.beginPath();
  c.moveTo(-0.5 * r, 0);
  c.lineTo(-0.2 * r, 0);
  c.lineTo(0, 0.12 * r);
  c.lineTo(0.2 * r, 0);
  c.lineTo(0.5 * r, 0);
  c.stroke();
  c.restore();
}

function drawHeading(c, colour, width, height, tape, ours, autopilot) {
  if (!isKnown(ours)) return;
  const [middle, top, perDegree] = [width / 2, height - tape + 8, Math.max(width / 140, 2.4)];
  c.save();
  c.beginPath();
  c.rect(0, top - 8, width, tape);
  c.clip();
  c.strokeStyle = c.fillStyle = colour.dim;
  c.font = "11px system-ui, sans-serif";
  c.textAlign = "center";
  c.textBaseline = "alphabetic";
  const words = { 0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW" };
  for (let degrees = 0; degrees < 360; degrees += 5) {
    const at = middle + turn(degrees, ours) * perDegree;
    if (at < -20 || at > width + 20) continue;
    line(c, at, top, at, top + (degrees % 15 ? 4 : 8));
    if (degrees % 15) continue;
    const text = String(words[degrees] ?? degrees);
    const half = c.measureText(text).width / 2;
    // Likewise one that the edge would cut
    if (at - half > 0 && at + half < width) c.fillText(text, at, height - 4);
  }
  c.fillStyle = colour.ours;
  pointer(c, middle, top);
  if (isKnown(autopilot)) {
    c.fillStyle = colour.autopilot;
    const away = turn(autopilot, ours) * perDegree;
    pointer(c, middle + Math.max(-middle + 6, Math.min(middle - 6, away)), top);
  }
  c.restore();
}

function pointer(c, x, y) {
  c.beginPath();
  c.moveTo(x, y + 1);
  c.lineTo(x - 5, y - 8);
  c.lineTo(x + 5, y - 8);
  c.fill();
}
