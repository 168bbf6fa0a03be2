// The budget slider: its places are round budgets, about evenly far apart as ratios.

const BUDGETS_MS = [
  2, 2.5, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60, 80, 100, 120, 150, 200, 250, 300, 400, 500,
  700, 1000, 2000, 5000, 10000,
];

/** The last place of the slider; the first is 0. */
export const LAST_PLACE = BUDGETS_MS.length - 1;

/** The budget at a place of the slider, in ms. */
export function budgetMsAt(place: number): number {
  return BUDGETS_MS[Math.min(Math.max(Math.round(place), 0), LAST_PLACE)] ?? 0;
}

/** The place of the largest budget that is not above `budgetMs`. */
export function placeOf(budgetMs: number): number {
  return Math.max(BUDGETS_MS.findLastIndex((each) => each <= budgetMs), 0);
}
