/** The page of a log. */
export function startLog() {}
