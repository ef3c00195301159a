/** Photographs, or a telephone's video, out of what was dropped or chosen: files, folders, ZIPs. */

import { unzipped } from "./zip";

export interface Dropped {
  file: File;
  /** Names of the folders in which it lay; empty for a file by itself. */
  folders: string[];
}

export interface Gathered {
  files: Dropped[];
  /** Sentences about what could not be opened. */
  refused: string[];
}

const PICTURE = /\.(jpe?g|png|tiff?)$/i;
const OF_TELEPHONE = /\.(jpe?g|png|hei[cf])$/i;
const VIDEO = /\.(mp4|mov|m4v)$/i;
const HIDDEN = /^(\.|__MACOSX)/;

/** All photographs of a drop. It must be called while the drop is being answered. */
export async function ofDrop(transfer: DataTransfer, heic: boolean): Promise<Gathered> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  if (entries.length === 0) return ofFiles([...transfer.files], heic);
  const found: Dropped[] = [];
  for (const entry of entries) found.push(...(await walked(entry, [])));
  return opened(found, heic);
}

/** All photographs of an input's files, whole folders and ZIPs too. */
export function ofFiles(files: File[], heic: boolean): Promise<Gathered> {
  return opened(files.map((file) => ({ file, folders: file.webkitRelativePath.split("/").slice(0, -1) })), heic);
}

async function walked(entry: FileSystemEntry, folders: string[]): Promise<Dropped[]> {
  if (entry.isFile) {
    const file = await new Promise<File>((done, failed) => (entry as FileSystemFileEntry).file(done, failed));
    return [{ file, folders }];
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  const found: Dropped[] = [];
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((done, failed) => reader.readEntries(done, failed));
    if (some.length === 0) return found; // a reader gives a hundred at a time
    for (const inner of some) found.push(...(await walked(inner, [...folders, entry.name])));
  }
}

/** Of a folder and a ZIP only the photographs are taken; a file that was chosen by itself and is none is named. */
async function opened(dropped: Dropped[], heic: boolean): Promise<Gathered> {
  const picture = heic ? OF_TELEPHONE : PICTURE;
  const words = heic ? "a photograph or video. Send the original JPEG, HEIC, PNG, MP4 or MOV of the telephone." : "a photograph. Send the original JPEG, PNG or TIFF of the camera.";
  const files: Dropped[] = [];
  const refused: string[] = [];
  for (const one of dropped) {
    const { file, folders } = one;
    if (isHidden(one)) continue;
    if (/\.zip$/i.test(file.name)) {
      try {
        files.push(...(await unzipped(file)).filter((inner) => !isHidden(inner) && picture.test(inner.file.name)));
      } catch (error) {
        refused.push(`${file.name}: ${error instanceof Error ? error.message : String(error)}`);
      }
    } else if (picture.test(file.name) || (heic && isVideo(file))) files.push(one);
    else if (folders.length === 0) refused.push(`${file.name}: This file is not ${words}`);
  }
  return heic ? ofOneKind(files, refused) : { files, refused };
}

/** Whether a file's name is that of a video. The server looks at its content. */
export function isVideo(file: File): boolean {
  return VIDEO.test(file.name);
}

/** Photographs, or one video. A video with the name of a photograph is the moving part of a live photo, and is not sent. */
function ofOneKind(files: Dropped[], refused: string[]): Gathered {
  const stem = ({ file }: Dropped) => file.name.replace(/\.[^.]*$/, "").toLowerCase();
  const photographs = files.filter(({ file }) => !isVideo(file));
  const stems = new Set(photographs.map(stem));
  const videos = files.filter((one) => isVideo(one.file) && !stems.has(stem(one)));
  if (videos.length === 0) return { files: photographs, refused };
  if (videos.length === 1 && photographs.length === 0) return { files: videos, refused };
  const found = [counted(videos.length, "video"), ...(photographs.length > 0 ? [counted(photographs.length, "photograph")] : [])].join(" and ");
  return { files: [], refused: [...refused, `${found}: Send either photographs or one video of the walk.`] };
}

function counted(number: number, what: string): string {
  return `${number} ${what}${number === 1 ? "" : "s"}`;
}

function isHidden({ file, folders }: Dropped): boolean {
  return [...folders, file.name].some((part) => HIDDEN.test(part));
}
