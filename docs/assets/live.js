/**
 * Puts the live comparison in the film's place, where the playground lies beside the site; the film
 * stays where it does not, or where the page says that it cannot run.
 */

const ADDRESS = "playground/home.html";
const room = document.getElementById("live"); // with the film

/** Show the page in a frame as high as what is in it; `theme.js` tells it the site's colours. */
function show() {
  const frame = document.createElement("iframe");
  frame.title = "One stream of boxes on two lines, live";
  frame.src = ADDRESS;
  frame.hidden = true;
  const begin = () => {
    room.firstElementChild.remove();
    frame.hidden = false;
    const root = frame.contentDocument.documentElement;
    const fit = () => {
      frame.style.height = `${Math.ceil(root.getBoundingClientRect().height)}px`;
    };
    new ResizeObserver(fit).observe(root);
  };
  frame.addEventListener("ready", begin, { once: true });
  room.append(frame);
}

try {
  const [page, tables] = await Promise.all(
    [ADDRESS, "playground/home.json"].map((address) => fetch(address, { method: "HEAD" })),
  );
  if (page.ok && tables.ok) show();
} catch {
  // There is no server: the site's files were opened by themselves.
}
