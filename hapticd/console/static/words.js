// Words: remedies that name a command name the button instead, and numbers are read as the command
// line reads them.

const BUTTONS = { "`hapticd reset`": "press Reset", "`hapticd guard warn`": "policy warn" };
const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;

export function ofPage(text) {
  return Object.entries(BUTTONS).reduce((found, [command, button]) => found.replaceAll(command, button), text);
}

// NaN: it is no number, as is one with a decimal comma.
export const number = (text) => (NUMBER.test(text) ? Number(text) : NaN);

export const noNumber = (name, text, unit) => `${name}: '${text}' is not a number; write it like 0.5, in ${unit}`;
