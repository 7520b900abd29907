// Draws the formulas of a page by KaTeX, which lies beside this file; other pages never load it.
const beside = document.currentScript.src.replace(/[^/]*$/, "");

function draw() {
  for (const place of document.querySelectorAll(".arithmatex")) {
    const text = place.textContent.trim();
    katex.render(text.slice(2, -2), place, { displayMode: text.startsWith("\\[") });
  }
}

document.addEventListener("DOMContentLoaded", () => {
  if (!document.querySelector(".arithmatex")) return;
  const style = document.createElement("link");
  style.rel = "stylesheet";
  style.href = `${beside}katex/katex.min.css`;
  const script = document.createElement("script");
  script.src = `${beside}katex/katex.min.js`;
  script.onload = draw;
  document.head.append(style, script);
});
