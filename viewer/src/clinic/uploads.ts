/** Photographs on their way to the clinic: in pieces, so that a cut line goes on where it was cut. */

import { post } from "./post";
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
}

interface State {
  cameras?: { camera: string; upload: Upload | null }[];
  poses?: Record<string, Record<string, Upload>>;
  unplaced: Upload[];
  set_aside: Upload[];
  together: Check[];
  ready: boolean;
  missing: string[];
}

const PATIENCE_MS = [500, 1000, 2000, 4000, 8000, 15000];
const AT_ONCE = 2; // more only share the same line

export function takePhotographs(): void {
  for (const root of document.querySelectorAll<HTMLElement>("[data-uploads]")) void new Photographs(root).start();
}

class Photographs {
  private readonly queue: { file: File; camera: string | null; pose: string | null }[] = [];
  private readonly said: HTMLElement;
  private working = 0;
  private failed = 0;

  constructor(private readonly root: HTMLElement) {
    this.said = root.querySelector<HTMLElement>("[data-said]")!;
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
        this.add([...(event.dataTransfer?.files ?? [])], null);
      });
    }
    this.root.addEventListener("change", (event) => {
      const target = event.target as HTMLElement;
      if (target instanceof HTMLInputElement && target.type === "file") {
        this.add([...(target.files ?? [])], target.dataset.camera ?? null);
        target.value = "";
      } else if (target instanceof HTMLSelectElement && target.dataset.place !== undefined && target.value !== "")
        void this.act(() => request(`${target.dataset.place}place/`, { json: { camera: target.value } }));
    });
    this.root.addEventListener("click", (event) => {
      const away = (event.target as HTMLElement).closest<HTMLElement>("[data-away]");
      if (away !== null) void this.act(() => request(away.dataset.away!, { method: "DELETE" }));
      const back = (event.target as HTMLElement).closest<HTMLElement>("[data-back]");
      if (back !== null) void this.act(() => request(`${back.dataset.back!}back/`, { method: "POST" }));
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

  private add(files: File[], camera: string | null): void {
    const pose = this.root.querySelector<HTMLInputElement>("[data-pose]")?.value ?? null;
    for (const file of files) this.queue.push({ file, camera, pose });
    this.say(files.length === 1 ? "Sending one photograph." : `Sending ${files.length} photographs.`);
    while (this.working < AT_ONCE && this.queue.length > 0) void this.work();
  }

  private async work(): Promise<void> {
    this.working += 1;
    for (let next = this.queue.shift(); next !== undefined; next = this.queue.shift()) {
      try {
        await this.send(next.file, next.camera, next.pose);
      } catch (error) {
        this.failed += 1;
        this.say(error instanceof Refused ? `${next.file.name}: ${error.message}` : "The photograph could not be sent. Try again.");
      }
      await this.refresh().catch(() => undefined);
    }
    this.working -= 1;
    if (this.working > 0) return;
    if (this.failed === 0 && this.root.dataset.ready === "true") this.say("All photographs are here.");
    this.failed = 0;
  }

  private async send(file: File, camera: string | null, pose: string | null): Promise<void> {
    const { for: target, id } = this.root.dataset;
    const sha256 = await digest(file);
    const begin = { for: target, id, name: file.name, camera, size_bytes: file.size, sha256, ...(pose === null ? {} : { pose }) };
    let upload = await this.patiently(() => request<Upload>("/uploads/", { json: begin }));
    while (upload.state === "receiving" && upload.offset < upload.size_bytes) {
      const { offset, url, chunk_bytes } = upload;
      this.show(file.name, offset / file.size);
      upload = await this.patiently(async (again) => {
        if (again) return request<Upload>(url);
        const headers = { "Upload-Offset": String(offset), "Content-Type": "application/offset+octet-stream" };
        return request<Upload>(url, { method: "PATCH", headers, body: file.slice(offset, offset + chunk_bytes) });
      });
    }
    this.show(file.name, 1);
  }

  /** Try until the line is there again; what the server refuses is not tried twice. */
  private async patiently(act: (again: boolean) => Promise<Upload>): Promise<Upload> {
    for (let attempt = 0; ; attempt += 1) {
      try {
        return await act(attempt > 0);
      } catch (error) {
        if (error instanceof Refused && error.status === 409 && "offset" in error.reply) return error.reply as Reply & Upload;
        if ((error instanceof Refused && error.status < 500) || attempt > 40) throw error;
        this.say("The connection is gone. The photograph goes on by itself when it is back.");
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

  /** Show what the server has. */
  private async refresh(): Promise<void> {
    const state = await request<State>(this.root.dataset.uploads!);
    const list = this.root.querySelector<HTMLElement>("[data-places]")!;
    const cameras = (state.cameras ?? []).map(({ camera }) => camera);
    const places = state.cameras?.map(({ camera, upload }) => this.place(camera, camera, upload)) ?? [];
    for (const [pose, shots] of Object.entries(state.poses ?? {}))
      for (const [camera, upload] of Object.entries(shots)) places.push(this.place(`Pose ${pose}, ${camera}`, null, upload));
    for (const upload of state.unplaced) places.push(this.place("Which camera took this?", null, upload, cameras));
    list.replaceChildren(...places);
    const together = this.root.querySelector<HTMLElement>("[data-together]");
    if (together !== null) {
      const warnings = state.together.filter(({ level }) => level === "warn" || level === "refuse");
      together.replaceChildren(...warnings.map(warned));
      together.hidden = warnings.length === 0;
    }
    const aside = this.root.querySelector<HTMLElement>("[data-aside]");
    if (aside !== null) {
      aside.hidden = state.set_aside.length === 0;
      aside.querySelector("summary")!.textContent = `Set aside (${state.set_aside.length})`;
      aside.querySelector("ul")!.replaceChildren(...state.set_aside.map(keptAside));
    }
    this.root.dataset.ready = String(state.ready);
    const go = this.root.querySelector<HTMLButtonElement>("[data-go]");
    if (go !== null) go.disabled = !state.ready;
    const missing = this.root.querySelector<HTMLElement>("[data-missing]");
    if (missing !== null)
      missing.textContent = state.ready ? "Everything is here." : state.missing.length > 0 ? `Still missing: ${state.missing.map(title).join(", ")}.` : "";
  }

  private place(name: string, camera: string | null, upload: Upload | null, cameras: string[] = []): HTMLElement {
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
    if (upload?.state === "checked") item.append(chooser(upload, cameras));
    if (camera !== null) item.append(picker(camera, upload === null ? "Choose photograph" : "Another photograph"));
    if (upload !== null) {
      const words = upload.state === "placed" ? "Set aside" : "Take away";
      const away = button(words, `${words}: the photograph of ${title(name)}`);
      away.dataset.away = upload.url;
      item.append(away);
    }
    return item;
  }

  private show(name: string, fraction: number): void {
    const bar = this.root.querySelector<HTMLProgressElement>("[data-sent]");
    if (bar === null) return;
    bar.hidden = fraction >= 1 && this.queue.length === 0;
    bar.value = fraction;
    bar.setAttribute("aria-label", `${name} on its way`);
  }

  private say(text: string): void {
    this.said.textContent = text;
  }
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
    image.alt = `Photograph: ${title(name)}`;
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

function chooser(upload: Upload, cameras: string[]): HTMLElement {
  const select = made("select", "") as HTMLSelectElement;
  select.dataset.place = upload.url;
  select.setAttribute("aria-label", "Which camera took this photograph?");
  select.append(new Option("Choose the camera", ""), ...cameras.map((camera) => new Option(title(camera), camera)));
  return select;
}

function made(tag: string, kind: string, text = ""): HTMLElement {
  const element = document.createElement(tag);
  if (kind !== "") element.className = kind;
  if (text !== "") element.textContent = text;
  return element;
}

/** SHA-256 of a file; empty where the browser keeps it to encrypted pages: the server then takes its own. */
async function digest(file: File): Promise<string> {
  if (!window.isSecureContext) return "";
  const sum = await crypto.subtle.digest("SHA-256", await file.arrayBuffer());
  return [...new Uint8Array(sum)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
