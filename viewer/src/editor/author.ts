/** The name of who draws, remembered in a cookie: every start has another port, and storage is kept by port. */

const NAME_DAYS = 365;

export function rememberName(name: string): void {
  const lasting = `max-age=${NAME_DAYS * 86400}; path=/; samesite=strict`;
  document.cookie = `mammometry-author=${encodeURIComponent(name.trim())}; ${lasting}`;
}

export function rememberedName(): string {
  const found = /(?:^|; )mammometry-author=([^;]*)/.exec(document.cookie);
  return found === null ? "" : decodeURIComponent(found[1]!);
}
