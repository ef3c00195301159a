/** Photographs out of what was dropped or chosen: files, folders, ZIPs. */

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
  const kinds = heic ? "JPEG, HEIC or PNG of the telephone" : "JPEG, PNG or TIFF of the camera";
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
    } else if (picture.test(file.name)) files.push(one);
    else if (folders.length === 0) refused.push(`${file.name}: This file is not a photograph. Send the original ${kinds}.`);
  }
  return { files, refused };
}

function isHidden({ file, folders }: Dropped): boolean {
  return [...folders, file.name].some((part) => HIDDEN.test(part));
}
