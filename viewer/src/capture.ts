/** Live pictures of a rig's cameras with their aids, and the button that fires: on the local page and the clinic's. */

import { request } from "./clinic/request";

interface Aids {
  picture: string;
  sharpness: number[][];
  histogram: number[];
  saturated: number;
  whole: string;
  is_whole: boolean;
  target: number | null;
  covered: boolean[][];
}

type Seen = Aids | { fault: string };

/** Where to hold the board next: corners by camera, as shares of its picture's width and height. */
interface Guidance {
  next: string;
  outlines: Record<string, [number, number][]>;
}

interface State extends Partial<Guidance> {
  title: string;
  cameras: string[];
  faults: Record<string, string>;
  calibrated: boolean;
  board: boolean;
  posing: boolean;
}

interface Fired extends Partial<Guidance> {
  accepted: boolean;
  said: string[];
}

interface Shown {
  figure: HTMLElement;
  image: HTMLImageElement;
  over: HTMLCanvasElement;
  bars: HTMLCanvasElement;
  said: HTMLElement;
  sharp: HTMLElement;
  best: number;
}

const TOO_BRIGHT = 0.02; // share of saturated pixels from which a picture is called so
const REGIONS_PX = [480, 320] as const; // of the canvas over a picture

const pause = (ms: number): Promise<void> => new Promise((done) => setTimeout(done, ms));

class Capture {
  private readonly shown = new Map<string, Shown>();
  private readonly fire = made("button", "button main", "Fire");
  private readonly board = document.createElement("input");
  private readonly verdict = made("section", "cap-verdict said");
  private readonly all = made("p", "cap-all");
  private readonly cameras = made("div", "cap-cameras");
  private outlines: Guidance["outlines"] = {};
  private posing = false;
  private firing = false;

  constructor(private readonly root: HTMLElement) {
    this.board.type = "checkbox";
    this.fire.type = "button";
    this.verdict.setAttribute("role", "status");
    this.verdict.setAttribute("aria-live", "polite");
    this.verdict.hidden = true;
    this.fire.addEventListener("click", () => void this.shoot());
  }

  async start(): Promise<void> {
    const state = await this.asked<State>("state");
    this.posing = state.posing;
    const tools = made("div", "cap-tools acts");
    tools.append(this.fire);
    if (state.board && !state.posing) {
      const label = made("label", "choice");
      label.append(this.board, " Look for the board");
      tools.append(label);
    }
    if (!this.root.dataset.title) document.title = state.title;
    this.root.replaceChildren(tools, this.verdict, this.all, this.cameras);
    for (const name of state.cameras) this.add(name);
    const warnings = Object.entries(state.faults).map(([name, fault]) => `${name}: ${fault}`);
    if (!state.calibrated && !state.posing) warnings.push("The rig is not calibrated: camera names are not checked.");
    if (state.next) warnings.push(`Next: ${state.next}`);
    this.outlines = state.outlines ?? {};
    if (warnings.length > 0) this.tell("Before you fire", "care", warnings);
    void this.live();
  }

  private asked<T>(where: string, json?: object): Promise<T> {
    return request<T>(this.root.dataset.at + where, json === undefined ? {} : { json });
  }

  private add(name: string): void {
    const figure = made("figure", "cap-camera");
    const head = document.createElement("figcaption");
    const sharp = made("span", "cap-sharp");
    head.append(made("span", "", name), sharp);
    const view = made("div", "cap-view");
    const image = document.createElement("img");
    image.alt = `Live picture of ${name}`;
    const over = document.createElement("canvas");
    [over.width, over.height] = REGIONS_PX;
    const bars = document.createElement("canvas");
    bars.className = "cap-bars";
    bars.setAttribute("aria-hidden", "true");
    over.setAttribute("aria-hidden", "true");
    [bars.width, bars.height] = [320, 34];
    view.append(image, over);
    const said = made("p", "cap-said");
    figure.append(head, view, bars, said);
    this.cameras.append(figure);
    this.shown.set(name, { figure, image, over, bars, said, sharp, best: 0 });
  }

  private get calibrating(): boolean {
    return this.posing || this.board.checked;
  }

  private async live(): Promise<void> {
    for (;;) {
      if (this.firing || document.hidden) {
        await pause(150);
        continue;
      }
      const calibrating = this.calibrating;
      try {
        const seen = await this.asked<{ cameras: Record<string, Seen>; wanted: Record<string, number> }>("look", { calibrating });
        for (const [name, one] of Object.entries(seen.cameras)) this.show(name, one, calibrating, seen.wanted[name] ?? 0);
        this.summarise(seen.cameras, calibrating);
      } catch (error) {
        this.tell("No live pictures", "bad", [words(error)]);
        await pause(2000);
      }
      await pause(20);
    }
  }

  /** One line for all views: is the subject complete in each? */
  private summarise(cameras: Record<string, Seen>, calibrating: boolean): void {
    const names = Object.entries(cameras).filter(([, one]) => "fault" in one || (calibrating ? !one.target : !one.is_whole)).map(([name]) => name);
    const what = calibrating ? "The board is visible" : "The subject is complete";
    const said = names.length === 0 ? `✓ ${what} in every view.` : `✕ ${what} in ${this.shown.size - names.length} of ${this.shown.size} views. Look at: ${names.join(", ")}.`;
    if (this.all.textContent !== said) this.all.textContent = said;
    this.all.className = `cap-all ${names.length === 0 ? "cap-good" : "cap-bad"}`;
  }

  private show(name: string, one: Seen, calibrating: boolean, wanted: number): void {
    const own = this.shown.get(name);
    if (own === undefined) return;
    if ("fault" in one) {
      own.said.textContent = one.fault;
      own.said.className = "cap-said cap-bad";
      return;
    }
    own.image.src = `data:image/jpeg;base64,${one.picture}`;
    const sharp = Math.max(...one.sharpness.flat());
    own.best = Math.max(own.best, sharp);
    own.sharp.textContent = `focus ${Math.round((100 * sharp) / (own.best || 1))} %`;
    this.draw(own, name, one, calibrating);
    histogram(own.bars, one);
    const said = calibrating
      ? [one.target ? `${one.target} points of the board.` : "No board.", `${wanted} of ${one.covered.flat().length} regions still needed.`]
      : [one.whole];
    if (one.saturated > TOO_BRIGHT) said.push(`${(100 * one.saturated).toFixed(0)} % too bright.`);
    own.said.textContent = said.join(" ");
    const bad = one.saturated > TOO_BRIGHT || (calibrating ? !one.target : !one.is_whole);
    own.said.className = `cap-said ${bad ? "cap-bad" : "cap-good"}`;
  }

  /** Sharpness by region; while calibrating, regions still wanted and the outline of the next pose. */
  private draw(own: Shown, name: string, one: Aids, calibrating: boolean): void {
    const pen = own.over.getContext("2d")!;
    const [across, down] = REGIONS_PX;
    pen.clearRect(0, 0, across, down);
    one.sharpness.forEach((row, i) =>
      row.forEach((value, j) => {
        const [width, height] = [across / row.length, down / one.sharpness.length];
        if (calibrating && !one.covered[i]![j]) {
          pen.fillStyle = "rgba(255, 196, 0, .28)";
          pen.fillRect(j * width + 1, i * height + 1, width - 2, height - 2);
        } else if (!calibrating) {
          pen.fillStyle = "rgba(64, 200, 255, .9)";
          pen.fillRect(j * width + 4, (i + 1) * height - 7, (width - 8) * value, 4);
        }
      }),
    );
    const outline = this.outlines[name];
    own.figure.dataset.outlined = String(calibrating && outline !== undefined);
    if (!calibrating || outline === undefined) return;
    pen.strokeStyle = "#ff4fd8";
    pen.lineWidth = 4;
    pen.beginPath();
    for (const [x, y] of outline) pen.lineTo(x * across, y * down);
    pen.closePath();
    pen.stroke();
  }

  private tell(title: string, kind: "good" | "care" | "bad", lines: string[]): void {
    const list = document.createElement("ul");
    list.append(...lines.map((line) => made("li", "", line)));
    this.verdict.replaceChildren(made("strong", "", title), list);
    this.verdict.className = `cap-verdict said ${kind}`;
    this.verdict.hidden = false;
  }

  private async shoot(): Promise<void> {
    this.firing = this.fire.disabled = true;
    try {
      const fired = await this.asked<Fired>("fire", {});
      this.outlines = fired.outlines ?? {};
      const lines = fired.next ? [...fired.said, `Next: ${fired.next}`] : fired.said;
      const title = this.posing ? "The pose is stored." : "The pictures may be measured.";
      this.tell(fired.accepted ? title : "Do not measure these pictures.", fired.accepted ? "good" : "bad", lines);
      if (fired.accepted && this.root.dataset.go) this.offer(this.root.dataset.go);
    } catch (error) {
      this.tell("Nothing was captured", "bad", [words(error)]);
    }
    this.firing = this.fire.disabled = false;
  }

  /** The job, a press away; what a careful person may pass is passed by a second press. */
  private offer(address: string): void {
    const acts = made("div", "acts");
    const go = made("button", "button main", this.root.dataset.goWords ?? "Measure");
    const refused = made("span", "");
    let anyway = false;
    go.type = "button";
    go.addEventListener("click", () => {
      void request(address, { json: anyway ? { anyway } : {} }).then(
        () => window.location.assign(this.root.dataset.next!),
        (error: unknown) => {
          refused.textContent = words(error);
          anyway = true;
          go.textContent = "Go on anyway";
        },
      );
    });
    acts.append(go, refused);
    this.verdict.append(acts);
  }

}

function made<K extends keyof HTMLElementTagNameMap>(tag: K, name: string, text = ""): HTMLElementTagNameMap[K] {
  const one = document.createElement(tag);
  if (name) one.className = name;
  if (text) one.textContent = text;
  return one;
}

function histogram(bars: HTMLCanvasElement, one: Aids): void {
  const ink = bars.getContext("2d")!;
  const most = Math.max(...one.histogram);
  ink.clearRect(0, 0, bars.width, bars.height);
  one.histogram.forEach((count, i) => {
    const [height, width] = [bars.height * Math.sqrt(count / most), bars.width / one.histogram.length];
    ink.fillStyle = i === one.histogram.length - 1 && one.saturated > TOO_BRIGHT ? "#a3140d" : "#5d6779";
    ink.fillRect(i * width, bars.height - height, width - 1, height);
  });
}

function words(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

const root = document.getElementById("mm-capture");
if (root !== null) new Capture(root).start().catch((error: unknown) => (root.textContent = `The cameras cannot be used: ${words(error)}`));
