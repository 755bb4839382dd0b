for (const chart of document.querySelectorAll("figure.chart")) {
  const stage = chart.querySelector(".stage"), tip = chart.querySelector(".tip"), panel = chart.querySelector(".panel");
  panel.hidden = false;
  const showTip = (point) => {
    tip.textContent = point.getAttribute("aria-label");
    tip.hidden = false;
    const around = stage.getBoundingClientRect(), at = point.querySelector(".marker").getBoundingClientRect();
    const left = at.left - around.left + at.width / 2 - tip.offsetWidth / 2;
    tip.style.left = Math.max(0, Math.min(left, around.width - tip.offsetWidth)) + "px";
    const above = at.top - around.top - tip.offsetHeight - 8;
    tip.style.top = (above >= 0 ? above : at.bottom - around.top + 8) + "px";
  };
  const select = (point) => {
    for (const other of chart.querySelectorAll(".point.selected")) other.classList.remove("selected");
    point.classList.add("selected");
    const title = document.createElement("strong");
    title.textContent = point.getAttribute("aria-label");
    panel.replaceChildren(title, document.getElementById(point.dataset.row).querySelector("dl").cloneNode(true));
  };
  for (const key of chart.querySelectorAll(".legend .method")) {
    key.setAttribute("role", "button");
    key.tabIndex = 0;
    const choose = () => {
      const off = key.classList.contains("chosen");
      for (const other of chart.querySelectorAll(".legend .method")) other.classList.remove("chosen");
      if (!off) key.classList.add("chosen");
      for (const point of chart.querySelectorAll(".point"))
        point.classList.toggle("dim", !off && point.dataset.method !== key.dataset.method);
    };
    key.addEventListener("click", choose);
    key.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(); }
    });
  }
  for (const point of chart.querySelectorAll(".point")) {
    point.querySelector("title").remove();
    point.addEventListener("pointerenter", () => showTip(point));
    point.addEventListener("pointerleave", () => { tip.hidden = true; });
    point.addEventListener("focus", () => showTip(point));
    point.addEventListener("blur", () => { tip.hidden = true; });
    point.addEventListener("click", () => select(point));
    point.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); select(point); }
    });
  }
}
