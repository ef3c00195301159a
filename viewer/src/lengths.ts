/** Measured lengths, drawn over a picture: a line with its value each. */

import type { Vector } from "./format";

export interface Length {
  words: string;
  ends: [Vector, Vector];
}

const SVG = "http://www.w3.org/2000/svg";
const LINE_PX = 17; // height of a value's words
const LETTER_PX = 7;

export class Lengths {
  private readonly sheet = document.createElementNS(SVG, "svg");
  private readonly drawn: { line: SVGLineElement; words: SVGTextElement; length: Length }[];

  constructor(holder: HTMLElement, lengths: Length[]) {
    this.sheet.setAttribute("class", "mm-lengths");
    this.sheet.setAttribute("aria-hidden", "true"); // the page has the same numbers in a table
    this.drawn = lengths.map((length) => {
      const line = this.sheet.appendChild(document.createElementNS(SVG, "line"));
      const words = this.sheet.appendChild(document.createElementNS(SVG, "text"));
      words.textContent = length.words;
      return { line, words, length };
    });
    if (lengths.length > 0) holder.appendChild(this.sheet);
  }

  show(shown: boolean): void {
    this.sheet.toggleAttribute("hidden", !shown);
  }

  /** Draw them where a point of the model is in the picture, px. No value covers another one. */
  place(onPicture: (point: Vector) => [number, number]): void {
    const taken: { x: number; y: number; half: number }[] = [];
    for (const { line, words, length } of this.drawn) {
      const [first, second] = length.ends.map(onPicture) as [[number, number], [number, number]];
      attributes(line, { x1: first[0], y1: first[1], x2: second[0], y2: second[1] });
      const half = (LETTER_PX * length.words.length) / 2;
      const x = (first[0] + second[0]) / 2;
      let y = (first[1] + second[1]) / 2 - 5;
      const covers = () => taken.some((other) => Math.abs(other.x - x) < other.half + half && Math.abs(other.y - y) < LINE_PX);
      while (covers()) y += LINE_PX;
      taken.push({ x, y, half });
      attributes(words, { x, y });
    }
  }
}

function attributes(element: SVGElement, values: Record<string, number>): void {
  for (const [name, value] of Object.entries(values)) element.setAttribute(name, value.toFixed(1));
}
