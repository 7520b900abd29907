/** Elements of a page. */

/** Find an element by its id. @returns {any} */
export const find = (id) => document.getElementById(id);

/** Read a slider's number. */
export const number = (id) => Number(find(id).value);

/** Make an element with attributes and children. */
export function make(kind, attributes = {}, ...children) {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}
