/** A ZIP opened in the browser: its files then come in like any other, each checked by the server. */

import type { Dropped } from "./dropped";

const MOST_FILES = 2000;
const MOST_BYTES = 2 ** 30; // of one file, unpacked; the server's own limit is lower
const UNREADABLE = "The ZIP cannot be read. Pack it again, or drop the folder itself.";
const DEFLATED = 8;

/** All files of a ZIP. What it says of sizes is not believed. */
export async function unzipped(zip: File): Promise<Dropped[]> {
  const tail = new DataView(await zip.slice(Math.max(0, zip.size - 65557)).arrayBuffer());
  let at = tail.byteLength - 22;
  while (at >= 0 && tail.getUint32(at, true) !== 0x06054b50) at -= 1;
  if (at < 0) throw new Error(UNREADABLE);
  const [count, length, start] = [tail.getUint16(at + 10, true), tail.getUint32(at + 12, true), tail.getUint32(at + 16, true)];
  if (count > MOST_FILES) throw new Error(`The ZIP contains more than ${MOST_FILES} files. Pack only the photographs.`);
  const directory = new DataView(await zip.slice(start, start + length).arrayBuffer());
  const found: Dropped[] = [];
  for (let entry = 0, place = 0; entry < count; entry += 1) {
    if (place + 46 > directory.byteLength || directory.getUint32(place, true) !== 0x02014b50) throw new Error(UNREADABLE);
    const [flags, method, packed] = [directory.getUint16(place + 8, true), directory.getUint16(place + 10, true), directory.getUint32(place + 20, true)];
    const [named, extra, comment, offset] = [28, 30, 32].map((field) => directory.getUint16(place + field, true)).concat(directory.getUint32(place + 42, true)) as [number, number, number, number];
    const name = new TextDecoder().decode(new Uint8Array(directory.buffer, place + 46, named)).replaceAll("\\", "/");
    place += 46 + named + extra + comment;
    if (name.endsWith("/")) continue;
    if (flags & 1) throw new Error("The ZIP has a password. Pack it without one.");
    const header = new DataView(await zip.slice(offset, offset + 30).arrayBuffer());
    if (header.byteLength < 30 || header.getUint32(0, true) !== 0x04034b50) throw new Error(UNREADABLE);
    const begin = offset + 30 + header.getUint16(26, true) + header.getUint16(28, true);
    const parts = name.split("/").filter((part) => part !== "" && part !== "." && part !== "..");
    const data = zip.slice(begin, begin + packed);
    found.push({ file: new File([method === DEFLATED ? await inflated(data) : data], parts.at(-1) ?? "file"), folders: parts.slice(0, -1) });
  }
  return found;
}

async function inflated(packed: Blob): Promise<Blob> {
  const reader = packed.stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
  const parts: BlobPart[] = [];
  let left = MOST_BYTES;
  try {
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      left -= part.value.byteLength;
      if (left < 0) throw new Error("A file of the ZIP is too large.");
      parts.push(part.value as BlobPart);
    }
  } catch (error) {
    throw error instanceof TypeError ? new Error(UNREADABLE) : error;
  }
  return new Blob(parts);
}
