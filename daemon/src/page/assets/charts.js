// The last ten seconds of a quantity: a curve, its median and its 99th percentile.

const SECONDS = 10;
// Points further apart are not joined.
const GAP = 0.25;

export class Chart {
  constructor(canvas, figures, colour, nominal) {
    this.canvas = canvas;
    this.figures = figures;
    this.colour = colour;
    this.nominal = nominal;
    this.points = [];
  }

  // Takes a value, ms, at a time, seconds.
  add(time, value) {
    if (Number.isFinite(value)) this.points.push([time, value]);
  }

  draw(now) {
    const first = this.points.findIndex(([time]) => time > now - SECONDS);
    this.points.splice(0, first < 0 ? this.points.length : first);
    const sorted = this.points.map(([, value]) => value).sort((a, b) => a - b);
    this.write(sorted);
    this.plot(now, sorted);
  }

  write(sorted) {
    const share = (q) => sorted[Math.min(sorted.length - 1, Math.floor(q * sorted.length))];
    const figures = sorted.length === 0 ? [["", "no pose yet"]] : [
      ["median", `${share(0.5).toFixed(2)} ms`],
      ["99 %", `${share(0.99).toFixed(2)} ms`],
      ["worst", `${sorted.at(-1).toFixed(2)} ms`],
    ];
    write(this.figures, figures);
  }

  plot(now, sorted) {
    const ratio = devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.canvas;
    this.canvas.width = clientWidth * ratio;
    this.canvas.height = clientHeight * ratio;
    const draw = this.canvas.getContext("2d");
    draw.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    const [line, quiet, curve] = ["--line", "--quiet", this.colour]
      .map((name) => style.getPropertyValue(name));
    const [left, bottom] = [30, clientHeight - 4];
    const top = niceAbove(Math.max(sorted.at(-1) ?? 0, 2 * (this.nominal?.() ?? 0), 1));
    const x = (time) => left + (1 - (now - time) / SECONDS) * (clientWidth - left);
    const y = (value) => bottom - (value / top) * (bottom - 6);
    draw.font = "11px system-ui, sans-serif";
    draw.fillStyle = quiet;
    draw.strokeStyle = line;
    draw.textBaseline = "middle";
    for (const value of [0, top / 2, top]) {
      draw.beginPath();
      draw.moveTo(left, y(value));
      draw.lineTo(clientWidth, y(value));
      draw.stroke();
      draw.fillText(String(value), 0, Math.max(y(value), 6));
    }
    draw.strokeStyle = curve;
    draw.lineWidth = 1.25;
    draw.beginPath();
    let before = -Infinity;
    for (const [time, value] of this.points) {
      if (time - before > GAP) draw.moveTo(x(time), y(value));
      else draw.lineTo(x(time), y(value));
      before = time;
    }
    draw.stroke();
  }
}

// A round number at or above `value`.
function niceAbove(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10].map((digit) => digit * power)
    .find((nice) => nice >= value);
}

// Fills an element with pairs of name and value.
export function write(element, pairs) {
  element.replaceChildren(...pairs.map(([name, value]) => {
    const item = document.createElement("span");
    const bold = document.createElement("b");
    bold.textContent = value;
    item.append(name, name ? " " : "", bold);
    return item;
  }));
}
