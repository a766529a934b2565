// The camera picture with what was found in it and what the model expected.
const TIP = "#56b4e9", MODEL = "#ff9d4d", BOARD = "#f0e442";

export class PictureView {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
  }

  async show(blob, drawing) {
    const image = await createImageBitmap(blob);
    const { canvas, context } = this;
    if (canvas.width !== image.width || canvas.height !== image.height) {
      canvas.width = image.width;
      canvas.height = image.height;
    }
    context.drawImage(image, 0, 0);
    image.close();
    if (!drawing) return;
    const unit = canvas.width / 640;
    context.fillStyle = BOARD;
    for (const [u, v] of drawing.corners) context.fillRect(u - 1.5 * unit, v - 1.5 * unit, 3 * unit, 3 * unit);
    context.lineWidth = 3 * unit;
    const r = 9 * unit;
    this.mark(drawing.tip, TIP, (u, v) => context.arc(u, v, r, 0, 2 * Math.PI));
    this.mark(drawing.model, MODEL, (u, v) => context.rect(u - r, v - r, 2 * r, 2 * r));
  }

  mark([u, v], colour, path) {
    if (u === null || v === null) return;
    this.context.strokeStyle = colour;
    this.context.beginPath();
    path(u, v);
    this.context.stroke();
  }
}
