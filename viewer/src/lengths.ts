/** Measured lengths, drawn over a picture: a line with its value each. */

import type { Vector } from "./format";

export interface Length {
  words: string;
  ends: [Vector, Vector];
}

const SVG = "http://www.w3.org/2000/svg";
const LINE_PX = 15; // height of a value's words
const DOT_PX = 6;
const ALONG = [0.5, 0.35, 0.65, 0.2, 0.8]; // places of a value on its line
const ROWS = 14; // that a value may be moved up or down
const AWAY = [0, ...Array.from({ length: ROWS }, (_, row) => [-row - 1, row + 1]).flat()]; // above or below it, in heights

/** Where words stand, or a dot: their middle, and how far they reach. */
interface Box {
  x: number;
  y: number;
  width: number;
  height: number;
}

export class Lengths {
  private readonly sheet = document.createElementNS(SVG, "svg");
  private readonly drawn: { line: SVGPathElement; words: SVGTextElement; width: number; length: Length }[];

  constructor(holder: HTMLElement, lengths: Length[]) {
    this.sheet.setAttribute("class", "mm-lengths");
    this.sheet.setAttribute("aria-hidden", "true"); // the page has the same numbers in a table
    this.drawn = lengths.map((length) => {
      const line = this.sheet.appendChild(document.createElementNS(SVG, "path"));
      const words = this.sheet.appendChild(document.createElementNS(SVG, "text"));
      words.textContent = length.words;
      return { line, words, width: 0, length };
    });
    this.drawn.forEach(({ words }) => this.sheet.appendChild(words)); // over all lines
    if (lengths.length > 0) holder.appendChild(this.sheet);
  }

  show(shown: boolean): void {
    this.sheet.toggleAttribute("hidden", !shown);
  }

  /** Draw them where a point of the model is in the picture, px. No value covers another one, or the end of a line, or leaves the picture. */
  place(onPicture: (point: Vector) => [number, number]): void {
    const ends = this.drawn.map(({ length }) => length.ends.map(onPicture) as [[number, number], [number, number]]);
    const taken: Box[] = ends.flat().map(([x, y]) => ({ x, y, width: DOT_PX, height: DOT_PX }));
    const { clientWidth, clientHeight } = this.sheet;
    this.drawn.forEach((one, number) => {
      const [[x1, y1], [x2, y2]] = ends[number]!;
      one.width ||= one.words.getComputedTextLength();
      const boxes = AWAY.flatMap((away) =>
        ALONG.map((t) => ({
          x: within(x1 + t * (x2 - x1), one.width, clientWidth),
          y: within(y1 + t * (y2 - y1) + away * LINE_PX, LINE_PX, clientHeight),
          width: one.width,
          height: LINE_PX,
        })),
      );
      const box = boxes.find((free) => !taken.some((other) => cover(free, other))) ?? boxes[0]!;
      taken.push(box);
      const lead = boxes.indexOf(box) < ALONG.length ? "" : ` M${(x1 + x2) / 2} ${(y1 + y2) / 2}L${box.x} ${box.y}`;
      one.line.setAttribute("d", `M${x1} ${y1}L${x2} ${y2}${lead}`);
      one.words.setAttribute("x", box.x.toFixed(1));
      one.words.setAttribute("y", box.y.toFixed(1));
    });
  }
}

/** The middle of what is this long, moved so that it ends within the picture. */
function within(middle: number, long: number, picture: number): number {
  return Math.max(long / 2, Math.min(middle, picture - long / 2));
}

function cover(one: Box, other: Box): boolean {
  return (
    2 * Math.abs(one.x - other.x) < one.width + other.width && 2 * Math.abs(one.y - other.y) < one.height + other.height
  );
}
