/** A map under the track, of tiles in the web's Mercator projection, where their address is configured. */

const { tiles: address = "", credit = "" } = document.documentElement.dataset;
const EQUATOR = 156543.034; // m to a pixel of the one tile of zoom 0, at the equator
const FINEST = 18;
const KEPT = 300;
let pictures = {};

export const hasTiles = Boolean(address);

/** Latitude of a row, and what it is the inverse of: 0 at 85 degrees north, 1 at 85 south. */
const latOf = (row) => (Math.atan(Math.sinh(Math.PI * (1 - 2 * row))) * 180) / Math.PI;
const rowOf = (lat) => 0.5 - Math.asinh(Math.tan((lat * Math.PI) / 180)) / (2 * Math.PI);

function picture(url, onLoad) {
  if (!pictures[url]) {
    if (Object.keys(pictures).length > KEPT) pictures = {};
    const image = (pictures[url] = new Image());
    image.referrerPolicy = "origin"; // some servers refuse requests without a referrer
    image.onload = onLoad;
    image.src = url;
  }
  return pictures[url];
}

/**
 * Draw what lies between two corners; `pixel` gives the place of a latitude and longitude on the canvas,
 * and `onLoad` is called when another picture has come.
 */
export function drawTiles(c, [south, west], [north, east], scale, width, height, pixel, onLoad) {
  if (!(Math.abs(south) < 85 && Math.abs(north) < 85)) return;
  const metres = EQUATOR * Math.cos((((south + north) / 2) * Math.PI) / 180);
  const zoom = Math.min(Math.max(Math.round(Math.log2(metres * scale)), 0), FINEST);
  const count = 2 ** zoom;
  c.save();
  c.globalAlpha = 0.7;
  for (let x = Math.floor((west / 360 + 0.5) * count); x < (east / 360 + 0.5) * count; x++) {
    for (let y = Math.max(Math.floor(rowOf(north) * count), 0); y < Math.min(rowOf(south) * count, count); y++) {
      const column = ((x % count) + count) % count;
      const url = address.replace("{z}", zoom).replace("{x}", column).replace("{y}", y);
      const image = picture(url, onLoad);
      if (!image.complete || !image.naturalWidth) continue;
      const [left, top] = pixel(latOf(y / count), (x / count - 0.5) * 360).map(Math.round);
      const [right, bottom] = pixel(latOf((y + 1) / count), ((x + 1) / count - 0.5) * 360).map(Math.round);
      c.drawImage(image, left, top, right - left, bottom - top);
    }
  }
  c.restore();
  c.font = "10px system-ui, sans-serif";
  c.textAlign = "right";
  const words = credit || new URL(address).hostname;
  const long = Math.min(c.measureText(words).width + 8, width);
  c.fillStyle = "rgb(255 255 255 / 75%)";
  c.fillRect(width - long, height - 15, long, 15);
  c.fillStyle = "#333";
  c.fillText(words, width - 4, height - 4, width - 8);
}
