// Every text that can be seen, with its contrast to what is behind it, as WCAG 2 computes it.
() => {
  // Any CSS colour as numbers, by painting it.
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const numbers = (css) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = css;
    canvas.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = (top, under) => top.slice(0, 3).map((c, k) => c * top[3] + under[k] * (1 - top[3]));
  const light = (rgb) => {
    const [r, g, b] = rgb.map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92
      : ((c / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (node) => {
    const layers = [];
    for (let at = node; at; at = at.parentElement) layers.push(numbers(getComputedStyle(at).backgroundColor));
    return layers.reverse().reduce((under, top) => over(top, under), [255, 255, 255]);
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    const text = walker.currentNode.data.trim();
    if (!text || !node.checkVisibility() || node.closest(".unseen, script, noscript")) continue;
    const under = behind(node);
    const colour = over(numbers(getComputedStyle(node).color), under);
    const [low, high] = [light(colour), light(under)].sort((a, b) => a - b);
    found.push([text.slice(0, 40), Math.round(((high + 0.05) / (low + 0.05)) * 100) / 100]);
  }
  return found;
}
