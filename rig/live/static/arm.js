// The arm in space on a plain canvas: it needs no graphics card, which a lab's remote desktop may not have.
const SHOWN = 0.7; // of a tube's diameter: tubes side by side stay apart
const LOW = [0x2c, 0x7b, 0xb6], HIGH = [0xf0, 0x8c, 0x00]; // blue to orange: seen apart by everybody

export function pressureColour(share) {
  const s = Math.min(Math.max(share, 0), 1);
  return `rgb(${LOW.map((low, i) => Math.round(low + (HIGH[i] - low) * s)).join(",")})`;
}

export class ArmView {
  constructor(canvas, colour) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.colour = colour;
    this.turn = -0.5;
    this.tilt = 0.3;
    this.lines = null;
    this.points = [];
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      this.turn -= event.movementX * 0.01;
      this.tilt = Math.min(Math.max(this.tilt + event.movementY * 0.01, -1.4), 1.4);
      this.draw();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  begin(about) {
    this.about = about;
  }

  show(lines, pressures, points) {
    this.lines = lines;
    this.pressures = pressures;
    this.points = points.filter((point) => point !== null); // null: a section that is not measured
    this.draw();
  }

  // z hangs down; orthographic.
  project([x, y, z]) {
    const a = x * Math.cos(this.turn) - y * Math.sin(this.turn);
    const b = x * Math.sin(this.turn) + y * Math.cos(this.turn);
    return [this.cx + a * this.scale, this.cy + (z * Math.cos(this.tilt) + b * Math.sin(this.tilt)) * this.scale, b * Math.cos(this.tilt) - z * Math.sin(this.tilt)];
  }

  draw() {
    const { canvas, context, about } = this;
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!about || !width || !height) return;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const length = about.length_mm;
    this.scale = Math.min(height / (1.6 * length), width / (1.3 * length));
    this.cx = width / 2;
    this.cy = 0.12 * height;
    const ink = getComputedStyle(document.body);
    this.floor(length, ink.getPropertyValue("--rule"), ink.getPropertyValue("--muted"));
    if (this.lines && this.lines[0][0][0] !== null) this.tubes(ink, height - 32);
    this.sections(ink);
    this.scaleBar(width, height, ink);
  }

  // The measured sections, before the tubes that would hide them.
  sections(ink) {
    const { context } = this;
    context.strokeStyle = ink.getPropertyValue("--card");
    context.fillStyle = ink.getPropertyValue("--measured");
    context.lineWidth = 2;
    for (const point of this.points) {
      const [u, v] = this.project(point);
      context.beginPath();
      context.arc(u, v, 6, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }
  }

  floor(length, rule, muted) {
    const { context } = this;
    context.lineWidth = 1;
    context.strokeStyle = rule;
    for (let k = -2; k <= 2; k++) {
      const at = (k * length) / 4, end = length / 2;
      this.path([[at, -end, 0], [at, end, 0]]);
      this.path([[-end, at, 0], [end, at, 0]]);
    }
    context.fillStyle = context.strokeStyle = muted;
    context.font = "14px system-ui, sans-serif";
    for (const [name, axis] of [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]) {
      const end = axis.map((a) => (a * length) / 2.6);
      this.path([[0, 0, 0], end]);
      const [u, v] = this.project(end.map((e) => 1.12 * e));
      context.fillText(name, u - 4, v + 4);
    }
  }

  // Numbers of actuators stand no lower than `lowest`, where the bar of colours begins.
  tubes(ink, lowest) {
    const [axis, ...actuators] = this.lines;
    const limit = this.about.limit_bar;
    const segments = [];
    const collect = (points, colour, width) => {
      for (let i = 1; i < points.length; i++) {
        const a = this.project(points[i - 1]), b = this.project(points[i]);
        segments.push([a[2] + b[2], a, b, colour, width]);
      }
    };
    const wide = this.about.tube_mm.map((mm) => SHOWN * mm * this.scale);
    actuators.forEach((points, i) => collect(points, this.colour((this.pressures?.[i] ?? 0) / limit), wide[i]));
    collect(axis, ink.getPropertyValue("--ink"), 2.5);
    segments.sort((a, b) => b[0] - a[0]); // the far ones first
    const { context } = this;
    context.lineCap = "round";
    const paper = ink.getPropertyValue("--card");
    for (const [, a, b, colour, width] of segments) {
      context.beginPath();
      context.moveTo(a[0], a[1]);
      context.lineTo(b[0], b[1]);
      if (width > 5) {
        context.strokeStyle = paper; // a rim, so that one tube stands out before the other
        context.lineWidth = width + 3;
        context.lineCap = "butt";
        context.stroke();
      }
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.lineCap = "round";
      context.stroke();
    }
    context.lineCap = "butt";
    context.font = "600 16px system-ui, sans-serif";
    context.fillStyle = ink.getPropertyValue("--ink");
    actuators.forEach((points, i) => {
      const [u, v] = this.project(points.at(-1));
      context.fillText(String(i + 1), u - 5, Math.min(v + 0.65 * wide[i] + 18, lowest));
    });
  }

  scaleBar(width, height, ink) {
    const { context } = this;
    const wide = Math.min(180, width / 2), top = height - 26;
    const shade = context.createLinearGradient(8, 0, 8 + wide, 0);
    shade.addColorStop(0, this.colour(0));
    shade.addColorStop(1, this.colour(1));
    context.fillStyle = shade;
    context.fillRect(8, top, wide, 8);
    context.fillStyle = ink.getPropertyValue("--muted");
    context.font = "13px system-ui, sans-serif";
    context.fillText("0", 8, top + 22);
    context.fillText(`${this.about.limit_bar} bar`, wide - 30, top + 22);
  }

  path(points) {
    const { context } = this;
    context.beginPath();
    points.forEach((point, i) => {
      const [u, v] = this.project(point);
      if (i) context.lineTo(u, v);
      else context.moveTo(u, v);
    });
    context.stroke();
  }
}
