/** Starts the viewer in a report: the scene stands in the page, next to the place where it is shown. */

import type { PackedScene } from "./format";
import { Viewer } from "./viewer";

async function start(): Promise<void> {
  const root = document.getElementById("mm-viewer");
  const data = document.getElementById("mm-scene");
  if (root === null || data === null) return;
  try {
    const viewer = await Viewer.create(root, JSON.parse(data.textContent) as PackedScene);
    root.dataset.ready = String(viewer.stages.length);
  } catch (error) {
    root.replaceChildren();
    root.textContent = `The 3D view cannot be shown here (${error instanceof Error ? error.message : String(error)}). The pictures on this page show the same surface.`;
    root.dataset.ready = "0";
  }
}

void start();
