/** Uploads of photographs, in pieces, so that a lost connection continues where it stopped. */

import { type Dropped, type Gathered, isVideo, ofDrop, ofFiles } from "./dropped";
import { post } from "./post";
import { exchangedPart, suggested, suggestedForAll } from "./put_right";
import { Refused, type Reply, request } from "./request";

interface Check {
  check: string;
  level: "ok" | "unknown" | "warn" | "refuse";
  sentence: string;
  url?: string;
}

interface Upload {
  id: string;
  url: string;
  camera: string | null;
  pose: string | null;
  offset: number;
  size_bytes: number;
  chunk_bytes: number;
  state: "receiving" | "checked" | "placed" | "refused" | "set aside";
  checks: Check[];
  thumbnail: string | null;
  /** A telephone's video. */
  is_video: boolean;
  /** Name that a camera gave the file. */
  file: string | null;
  /** Its camera may be changed by hand: no serial number says it. */
  by_hand: boolean;
}

interface State {
  cameras?: { camera: string; upload: Upload | null }[];
  poses?: Record<string, Record<string, Upload>>;
  unplaced: Upload[];
  set_aside: Upload[];
  together: Check[];
  ready: boolean;
  missing: string[];
  /** Of a calibration: its cameras, and what is still needed. */
  known?: string[];
  needed?: string;
  /** Of a visit with a telephone: its photographs in their order. */
  shots?: Upload[];
  /** Of a visit: camera → camera in whose place its photograph is. */
  exchanged?: Record<string, string>;
  /** Of a visit: photograph without a camera → its camera by the calibration. */
  by_geometry?: Record<string, string>;
}

interface Waiting {
  file: File;
  camera: string | null;
  pose: string | null;
  /** As people know it: with its folders. */
  title: string;
  /** Its folder says which pose it is. */
  ofFolder: boolean;
  /** It may take the place of another. */
  replace: boolean;
  /** Its place was taken once; perhaps by one that was then refused. */
  tried?: boolean;
}

const PATIENCE_MS = [500, 1000, 2000, 4000, 8000, 15000];
const AT_ONCE = 2; // more only share the same line

export function takePhotographs(): void {
  for (const root of document.querySelectorAll<HTMLElement>("[data-uploads]")) void new Photographs(root).start();
}

class Photographs {
  private readonly queue: Waiting[] = [];
  private readonly said: HTMLElement;
  private readonly poseInput: HTMLInputElement | null;
  /** By a telephone: HEIC or one video may be sent, and any number of photographs. */
  private readonly heic: boolean;
  private occupied: Waiting[] = [];
  private refused: string[] = [];
  private working = 0;
  private total = 0;
  /** The pose was chosen by hand, and nothing was added since. */
  private typed = false;
  private sent = 0;
  /** The file that was sent last is a video. */
  private video = false;

  constructor(private readonly root: HTMLElement) {
    this.said = root.querySelector<HTMLElement>("[data-said]")!;
    this.poseInput = root.querySelector<HTMLInputElement>("[data-pose]");
    this.heic = root.dataset.heic !== undefined;
  }

  async start(): Promise<void> {
    const drop = this.root.querySelector<HTMLElement>("[data-drop]");
    if (drop !== null) {
      for (const kind of ["dragenter", "dragover"])
        drop.addEventListener(kind, (event) => {
          event.preventDefault();
          drop.classList.add("over");
        });
      for (const kind of ["dragleave", "drop"]) drop.addEventListener(kind, () => drop.classList.remove("over"));
      drop.addEventListener("drop", (event) => {
        event.preventDefault();
        if (event.dataTransfer !== null) void ofDrop(event.dataTransfer, this.heic).then((gathered) => this.add(gathered, null));
      });
    }
    this.poseInput?.addEventListener("input", () => (this.typed = true));
    this.root.addEventListener("change", (event) => {
      const target = event.target as HTMLElement;
      if (target instanceof HTMLInputElement && target.type === "file") {
        void ofFiles([...(target.files ?? [])], this.heic).then((gathered) => this.add(gathered, target.dataset.camera ?? null));
        target.value = "";
      } else if (target instanceof HTMLSelectElement && target.dataset.place !== undefined && target.value !== "")
        void this.act(() => request(`${target.dataset.place}place/`, { json: { camera: target.value } }));
    });
    this.root.addEventListener("click", (event) => {
      const away = (event.target as HTMLElement).closest<HTMLElement>("[data-away]");
      if (away !== null) void this.act(() => request(away.dataset.away!, { method: "DELETE" }));
      const back = (event.target as HTMLElement).closest<HTMLElement>("[data-back]");
      if (back !== null) void this.act(() => request(`${back.dataset.back!}back/`, { method: "POST" }));
      const right = (event.target as HTMLElement).closest<HTMLElement>("[data-put-right]");
      if (right !== null) void this.act(() => request(`/visits/${this.root.dataset.id!}/put-right/`, { json: { exchanged: JSON.parse(right.dataset.putRight!) as object } }));
      const put = (event.target as HTMLElement).closest<HTMLElement>("[data-put]");
      if (put !== null) void this.act(() => this.put(JSON.parse(put.dataset.put!) as Record<string, string>));
      const go = (event.target as HTMLElement).closest<HTMLElement>("[data-go]");
      if (go !== null) void this.go(go);
    });
    await this.refresh();
  }

  /** Have it computed; what stands in the way of a careful person may be passed by a second press. */
  private async go(button: HTMLElement): Promise<void> {
    const anyway = button.dataset.anyway === "true";
    const next = { next: window.location.pathname };
    const status = await post(button.dataset.go!, this.said, next, anyway ? { anyway } : {});
    if (status === 409 && !anyway && this.root.dataset.ready === "true" && this.root.dataset.for === "visit") {
      button.dataset.anyway = "true";
      button.textContent = "Measure anyway";
    }
  }

  private add({ files, refused }: Gathered, camera: string | null): void {
    if (this.working === 0) [this.refused, this.total, this.sent] = [[], 0, 0];
    this.refused.push(...refused);
    const current = this.poseInput?.value ?? null;
    this.typed = false;
    const several = new Set(files.map(({ folders }) => folders.join("/"))).size > 1;
    for (const one of files) {
      const folder = current === null ? undefined : poseOf(one, several);
      const title = [...one.folders, one.file.name].join("/");
      // Who chooses another photograph of a camera wants it in the place of the first.
      this.enqueue({ file: one.file, camera, pose: folder ?? current, title, ofFolder: folder !== undefined, replace: camera !== null });
    }
    if (files.length === 0) this.finish(refused.length > 0 ? "" : "There are no photographs in it.");
  }

  private enqueue(...waiting: Waiting[]): void {
    this.queue.push(...waiting);
    this.total += waiting.length;
    while (this.working < AT_ONCE && this.queue.length > 0) void this.work();
    this.allowGo();
  }

  private async work(): Promise<void> {
    this.working += 1;
    for (let next = this.queue.shift(); next !== undefined; next = this.queue.shift()) {
      const alone = isVideo(next.file) ? `Sending the video, ${megabytes(next.file)} MB.` : "Sending one photograph.";
      this.say(this.total === 1 ? alone : `Sending photograph ${this.sent + 1} of ${this.total}.`);
      this.video = isVideo(next.file);
      try {
        const upload = await this.send(next);
        const wrong = upload.checks.find(({ level }) => level === "refuse");
        if (upload.state === "refused") this.refused.push(`${next.title}: ${wrong?.sentence ?? "It cannot be used."}`);
      } catch (error) {
        if (error instanceof Refused && "occupied" in error.reply) this.occupied.push(next);
        else this.refused.push(`${next.title}: ${error instanceof Refused ? error.message : "It could not be sent. Try again."}`);
      }
      this.sent += 1;
      await this.refresh().catch(() => undefined);
    }
    this.working -= 1;
    if (this.working > 0) return;
    const occupied = this.occupied.splice(0);
    const again = occupied.filter(({ tried }) => tried !== true);
    const taken = occupied.filter(({ tried }) => tried === true);
    this.total -= occupied.length;
    this.sent -= occupied.length;
    this.enqueue(...again.map((one) => ({ ...one, tried: true })));
    if (taken.length > 0) await this.ask(taken);
    if (this.working === 0) this.finish();
  }

  /** Say how it went; what was refused is named. */
  private finish(words?: string): void {
    const arrived = this.total - this.refused.length;
    const alone = this.video ? "The video has arrived." : "One photograph has arrived.";
    const good = arrived === 1 ? alone : `${arrived} photographs have arrived.`;
    const ready = this.root.dataset.ready === "true" && this.refused.length === 0;
    this.say(words ?? (ready && this.poseInput === null && !this.heic ? "All photographs are here." : arrived > 0 ? good : ""));
    const state = document.querySelector<HTMLElement>('[data-state="new"] .chip, [data-state="uploading"] .chip');
    if (ready && state !== null) state.textContent = "ready to measure";
    const list = this.root.querySelector<HTMLElement>("[data-refused]");
    list?.replaceChildren(...this.refused.map((sentence) => made("li", "", sentence)));
    if (list) list.parentElement!.hidden = this.refused.length === 0;
    this.show("", 1);
    this.allowGo();
  }

  /** Nothing is computed from a part of what somebody sends: the button waits for the last photograph. */
  private allowGo(): void {
    const go = this.root.querySelector<HTMLButtonElement>("[data-go]");
    if (go !== null) go.disabled = this.root.dataset.ready !== "true" || this.working > 0;
  }

  /** Ask what to do with photographs whose places are taken. */
  private async ask(occupied: Waiting[]): Promise<void> {
    const names = occupied.map(({ title }) => title);
    const listed = names.length > 4 ? `${names.slice(0, 3).join(", ")} and ${names.length - 3} more` : names.join(", ");
    const next = this.nextPose();
    const another = this.poseInput !== null && occupied.every(({ ofFolder }) => !ofFolder);
    const choices = { ...(another ? { next: `They are of pose ${next}` } : {}), leave: "Keep those that are there", replace: "Replace them" };
    const chosen = await choose(occupied.length === 1 ? "This photograph is already there" : "These photographs are already there", `There are other photographs in the places of ${listed}.`, choices);
    if (chosen === "replace") this.enqueue(...occupied.map((one) => ({ ...one, replace: true })));
    else if (chosen === "next") {
      this.poseInput!.value = next;
      this.enqueue(...occupied.map((one) => ({ ...one, pose: next })));
    }
  }

  /** The first number after all poses that are there. */
  private nextPose(): string {
    const numbers = [...this.poses.keys()].filter((pose) => /^\d+$/.test(pose)).map(Number);
    return String(Math.max(0, ...numbers) + 1).padStart(2, "0");
  }

  private async send({ file, camera, pose, title: name, replace }: Waiting): Promise<Upload> {
    const { for: target, id } = this.root.dataset;
    const sha256 = await digest(file);
    const begin = { for: target, id, name: file.name, camera, replace, size_bytes: file.size, sha256, ...(pose === null ? {} : { pose }) };
    let upload = await this.patiently(() => request<Upload>("/uploads/", { json: begin }));
    while (upload.state === "receiving" && upload.offset < upload.size_bytes) {
      const { offset, url, chunk_bytes } = upload;
      this.show(name, (this.sent + offset / file.size) / this.total);
      if (isVideo(file) && offset + chunk_bytes >= file.size) this.say("Sending the last part, and checking the video.");
      upload = await this.patiently(async (again) => {
        if (again) return request<Upload>(url);
        const headers = { "Upload-Offset": String(offset), "Content-Type": "application/offset+octet-stream" };
        return request<Upload>(url, { method: "PATCH", headers, body: file.slice(offset, offset + chunk_bytes) });
      });
    }
    return upload;
  }

  /** Try until the line is there again; what the server refuses is not tried twice. */
  private async patiently(act: (again: boolean) => Promise<Upload>): Promise<Upload> {
    for (let attempt = 0; ; attempt += 1) {
      try {
        return await act(attempt > 0);
      } catch (error) {
        if (error instanceof Refused && [409, 422].includes(error.status) && "offset" in error.reply) return error.reply as Reply & Upload;
        if ((error instanceof Refused && error.status < 500) || attempt > 40) throw error;
        this.say("The connection is lost. The upload continues by itself when it is back.");
        await new Promise((done) => setTimeout(done, PATIENCE_MS[Math.min(attempt, PATIENCE_MS.length - 1)]));
      }
    }
  }

  private async act(what: () => Promise<unknown>): Promise<void> {
    try {
      await what();
    } catch (error) {
      this.say(error instanceof Refused ? error.message : "That did not work. Try again.");
    }
    await this.refresh();
  }

  /** Put photographs into the places of their cameras, by their addresses. */
  private async put(cameras: Record<string, string>): Promise<void> {
    for (const [address, camera] of Object.entries(cameras)) await request(`${address}place/`, { json: { camera } });
  }

  /** Show what the server has. */
  private async refresh(): Promise<void> {
    const state = await request<State>(this.root.dataset.uploads!);
    const list = this.root.querySelector<HTMLElement>("[data-places]")!;
    const cameras = state.known ?? (state.cameras ?? []).map(({ camera }) => camera);
    this.advance(state, cameras);
    const places = state.cameras?.map(({ camera, upload }) => this.place(camera, camera, upload, cameras)) ?? [];
    for (const [pose, shots] of Object.entries(state.poses ?? {}))
      for (const [camera, upload] of Object.entries(shots)) places.push(this.place(`Pose ${pose}, ${camera}`, null, upload, cameras));
    for (const [index, upload] of (state.shots ?? []).entries()) places.push(this.place(ofWalk(index, upload), null, upload, []));
    const told = state.by_geometry ?? {};
    for (const upload of state.unplaced) places.push(this.place("Which camera took this?", null, upload, cameras, told[upload.id]));
    list.replaceChildren(...suggestedForAll(state.unplaced, told), ...places);
    const together = this.root.querySelector<HTMLElement>("[data-together]");
    if (together !== null) {
      const warnings = state.together.filter(({ level }) => level === "warn" || level === "refuse");
      const shots = Object.fromEntries((state.cameras ?? []).map(({ camera, upload }) => [camera, upload?.thumbnail ?? null]));
      together.replaceChildren(...warnings.map(warned), ...exchangedPart(state.exchanged ?? {}, shots));
      together.hidden = warnings.length === 0;
    }
    const aside = this.root.querySelector<HTMLElement>("[data-aside]");
    if (aside !== null) {
      aside.hidden = state.set_aside.length === 0;
      aside.querySelector("summary")!.textContent = `Set aside (${state.set_aside.length})`;
      aside.querySelector("ul")!.replaceChildren(...state.set_aside.map(keptAside));
    }
    this.root.dataset.ready = String(state.ready);
    this.allowGo();
    const missing = this.root.querySelector<HTMLElement>("[data-missing]");
    if (missing !== null) {
      const lacking = state.missing.length > 0 ? `Still missing: ${state.missing.map(title).join(", ")}.` : "";
      missing.textContent = this.heic ? (state.needed ?? "") : state.ready ? (lacking || (state.known ? "These poses can be calibrated; ten are better." : "Everything is here.")) : [lacking, state.needed ?? ""].join(" ").trim();
    }
  }

  private readonly poses = new Map<string, Set<string>>();

  /** Go on to the next pose as soon as every camera has photographed this one. */
  private advance(state: State, cameras: string[]): void {
    if (this.poseInput === null) return;
    this.poses.clear();
    for (const [pose, shots] of Object.entries(state.poses ?? {}))
      this.poses.set(pose, new Set(Object.entries(shots).flatMap(([camera, { state: now }]) => (now === "placed" ? [camera] : []))));
    const here = this.poses.get(this.poseInput.value);
    const whole = here !== undefined && cameras.every((camera) => here.has(camera));
    if (whole && this.queue.length === 0 && !this.typed) this.poseInput.value = this.nextPose();
  }

  private place(name: string, camera: string | null, upload: Upload | null, cameras: string[], told?: string): HTMLElement {
    const level = upload === null ? "" : worst(upload);
    const item = made("li", `place ${level === "" ? "" : { ok: "good", warn: "care", refuse: "bad" }[level]}`);
    const head = made("h3", "", title(name));
    head.append(chip(upload, level));
    item.append(head);
    item.append(shotOf(upload, name));
    if (upload !== null) {
      const wrong = upload.checks.filter((check) => check.level === "warn" || check.level === "refuse");
      if (wrong.length > 0) {
        const list = made("ul", "");
        list.append(...wrong.map((check) => made("li", "", check.sentence)));
        item.append(list);
      }
    }
    if (upload?.file && (upload.state === "checked" || this.heic)) item.append(made("p", "small faint", upload.file));
    if (upload?.state === "checked") item.append(...(told === undefined ? [] : suggested(upload.url, told)), chooser(upload, cameras, "Choose the camera"));
    if (upload?.by_hand === true) item.append(chooser(upload, cameras.filter((camera) => camera !== upload.camera), "Another camera took it"));
    if (camera !== null) item.append(picker(camera, upload === null ? "Choose photograph" : "Another photograph"));
    if (upload !== null) {
      const words = upload.state === "placed" && !this.heic ? "Set aside" : "Take away";
      const away = button(words, `${words}: ${upload.is_video ? "the video" : `the photograph of ${title(name)}`}`);
      away.dataset.away = upload.url;
      item.append(away);
    }
    return item;
  }

  private show(name: string, fraction: number): void {
    const bar = this.root.querySelector<HTMLProgressElement>("[data-sent]");
    if (bar === null) return;
    bar.hidden = this.working === 0;
    bar.value = fraction;
    bar.setAttribute("aria-label", `${name} on its way`);
  }

  private say(text: string): void {
    this.said.textContent = text;
  }
}

/** Pose that a photograph's folder names, where several folders came or the folder is a number. */
function poseOf({ folders }: Dropped, several: boolean): string | undefined {
  const folder = folders.at(-1);
  if (folder === undefined || !/^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$/.test(folder)) return undefined;
  return several || /^\d+$/.test(folder) ? folder : undefined;
}

/** Title of a telephone's photograph: its number, if it can be used. */
function ofWalk(index: number, upload: Upload): string {
  if (upload.state === "placed") return upload.is_video ? "Video" : String(index + 1).padStart(2, "0");
  return upload.state === "receiving" ? "Arriving" : "Not taken";
}

/** A question with several answers; empty where it was left. */
function choose(heading: string, words: string, choices: Record<string, string>): Promise<string> {
  const dialog = document.createElement("dialog");
  dialog.className = "again";
  const head = made("h2", "", heading);
  head.id = "choose-title";
  dialog.setAttribute("aria-labelledby", head.id);
  const acts = made("div", "acts");
  for (const [value, text] of Object.entries(choices)) {
    const button = made("button", "button", text) as HTMLButtonElement;
    button.type = "button";
    button.addEventListener("click", () => dialog.close(value));
    acts.append(button);
  }
  dialog.append(head, made("p", "", words), acts);
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((done) =>
    dialog.addEventListener("close", () => {
      dialog.remove();
      done(dialog.returnValue);
    }),
  );
}

function title(camera: string): string {
  const words = camera.replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

function worst(upload: Upload): "ok" | "warn" | "refuse" | "" {
  if (upload.state === "receiving") return "";
  if (upload.state === "refused") return "refuse";
  return upload.checks.some(({ level }) => level === "warn") ? "warn" : upload.state === "placed" ? "ok" : "";
}

function chip(upload: Upload | null, level: string): HTMLElement {
  if (upload === null) return made("span", "chip", "missing");
  if (upload.state === "receiving") return made("span", "chip busy", `${Math.round((100 * upload.offset) / upload.size_bytes)} %`);
  if (upload.state === "checked") return made("span", "chip care", "? choose");
  if (level === "refuse") return made("span", "chip bad", "✕ not usable");
  if (level === "warn") return made("span", "chip care", "! look");
  return made("span", "chip good", "✓ good");
}

function picker(camera: string, words: string): HTMLElement {
  const label = made("label", "button", words);
  const input = made("input", "unseen") as HTMLInputElement;
  input.type = "file";
  input.accept = "image/jpeg,image/png,image/tiff";
  input.dataset.camera = camera;
  input.setAttribute("aria-label", `${words}: ${title(camera)}`);
  label.append(input);
  return label;
}

/** The small picture of a photograph, or its empty place. */
function shotOf(upload: Upload | null, name: string): HTMLElement {
  const shot = made("div", upload === null ? "none" : "shot");
  if (upload?.thumbnail) {
    const image = made("img", "") as HTMLImageElement;
    image.src = upload.thumbnail;
    image.alt = upload.is_video ? "A frame of the video" : `Photograph: ${title(name)}`;
    shot.append(image);
  }
  return shot;
}

/** A photograph that was set aside, with the button that brings it back. */
function keptAside(upload: Upload): HTMLElement {
  const name = [upload.pose === null ? "" : `pose ${upload.pose},`, upload.camera ?? ""].join(" ").trim();
  const item = made("li", "place");
  const back = button("Bring back", `Bring back the photograph of ${title(name)}`);
  back.dataset.back = upload.url;
  item.append(made("h3", "", title(name)), shotOf(upload, name), back);
  return item;
}

/** What photographs say together; one that lies in another visit too leads there. */
function warned(check: Check): HTMLElement {
  const line = made("p", "", check.sentence);
  if (check.url !== undefined) {
    const link = made("a", "", "Open that visit") as HTMLAnchorElement;
    link.href = check.url;
    line.append(" ", link);
  }
  return line;
}

function button(words: string, label: string): HTMLButtonElement {
  const element = made("button", "button", words) as HTMLButtonElement;
  element.type = "button";
  element.setAttribute("aria-label", label);
  return element;
}

function chooser(upload: Upload, cameras: string[], words: string): HTMLElement {
  const select = made("select", "") as HTMLSelectElement;
  select.dataset.place = upload.url;
  const which = upload.camera === null ? "" : `: the photograph of ${title(upload.camera)}`;
  select.setAttribute("aria-label", upload.state === "checked" ? "Which camera took this photograph?" : `${words}${which}`);
  select.append(new Option(words, ""), ...cameras.map((camera) => new Option(title(camera), camera)));
  return select;
}

function made(tag: string, kind: string, text = ""): HTMLElement {
  const element = document.createElement(tag);
  if (kind !== "") element.className = kind;
  if (text !== "") element.textContent = text;
  return element;
}

function megabytes(file: File): number {
  return Math.max(1, Math.round(file.size / 1e6));
}

/**
 * SHA-256 of a file. Empty where the browser keeps it to encrypted pages, and for a video, which the browser would have
 * to hold in memory: the server then takes its own.
 */
async function digest(file: File): Promise<string> {
  if (!window.isSecureContext || isVideo(file)) return "";
  const sum = await crypto.subtle.digest("SHA-256", await file.arrayBuffer());
  return [...new Uint8Array(sum)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
