// Numbers as people read them.

/** `4.2 ms`, `87 ms`. */
export function ms(value: number): string {
  if (value === 0) {
    return "0 ms";
  }
  return `${value < 9.95 ? value.toFixed(1) : value.toFixed(0)} ms`;
}

/** A share from 0 to 1 as `93 %`. */
export function percent(share: number): string {
  return `${(100 * share).toFixed(0)} %`;
}

/** `1 frame`, `2 frames`, `20 000 frames`. */
export function count(value: number, one: string, many = `${one}s`): string {
  return `${grouped(value)} ${value === 1 ? one : many}`;
}

/** `20 000`, with a space that doesn't break. */
export function grouped(value: number): string {
  return value.toFixed(0).replace(/\B(?=(\d{3})+(?!\d))/g, "\u00a0");
}

/** Three significant digits without an exponent. */
export function short(value: number): string {
  const digits = value === 0 ? 0 : Math.max(0, 2 - Math.floor(Math.log10(Math.abs(value))));
  return value.toFixed(Math.min(digits, 4));
}
