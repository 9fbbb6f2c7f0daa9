// Run in a page: what somebody with a screen reader, a keyboard, weak eyes or unsteady hands would stumble over and axe
// does not find. axe takes a placeholder for a label, passes over references that lead nowhere, identifiers that stand
// twice, drawings without a role, canvases, native dialogues, tables without headings, texts in drawings, and a small
// target that stands alone; and it measures neither the page's width nor where Tab leads.
() => {
  const faults = [];
  const CONTRAST_MIN = 4.5, CONTRAST_LARGE_MIN = 3, LARGE_PX = 24, LARGE_BOLD_PX = 18.66, TARGET_MIN_PX = 24;
  const CONTROLS = 'button, a[href], input:not([type=hidden]), select, textarea, summary, [role=button], [role=tab], ' +
    '[role=link], [role=checkbox], [role=switch], [role=radio], [role=menuitem], [role=option], [role=slider]';
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const modal = all('dialog[open]').find((dialog) => dialog.matches(':modal'));
  const scope = modal ?? document.body;

  const shows = (element) => element.checkVisibility({ opacityProperty: true, visibilityProperty: true }) &&
    !element.closest('[inert]');
  const isClipped = (element) => {
    const box = element.getBoundingClientRect();
    return box.width <= 1 || box.height <= 1;
  };
  const isSpoken = (element) => shows(element) && !element.closest('[aria-hidden=true]');
  const say = (element) => {
    const text = (element.textContent || element.getAttribute('aria-label') || '').trim().replace(/\s+/g, ' ');
    const id = element.id ? `#${element.id}` : '';
    const classes = typeof element.className === 'string' && element.className ?
      `.${element.className.trim().replace(/\s+/g, '.')}` : '';
    return `<${element.localName}${id}${classes}>${text ? ` “${text.slice(0, 50)}”` : ''}`;
  };
  const referred = (element, attribute) => (element.getAttribute(attribute) || '').split(/\s+/).filter(Boolean)
    .map((id) => document.getElementById(id));
  const isNamed = (element) => Boolean((element.getAttribute('aria-label') || '').trim() ||
    referred(element, 'aria-labelledby').some((named) => named?.textContent.trim()));

  // The document.
  const seen = new Set();
  for (const element of all('[id]')) {
    if (seen.has(element.id)) faults.push(`id: ${element.id} stands twice`);
    seen.add(element.id);
  }
  const root = document.scrollingElement;
  if (root.scrollWidth > root.clientWidth + 1) {
    faults.push(`reflow: the page is ${root.scrollWidth} px wide in a window of ${root.clientWidth} px`);
  }

  // A table that is wider than its place scrolls there, alone, where a keyboard comes and a reader hears what it is.
  for (const table of all('table').filter(isSpoken)) {
    const isCut = (one) => getComputedStyle(one).overflowX !== 'visible' && one.scrollWidth > one.clientWidth + 1;
    let holder = table;
    while (holder && !isCut(holder)) holder = holder.parentElement;
    if (!holder || holder === root || holder === document.body) continue;
    const isScrolled = ['auto', 'scroll'].includes(getComputedStyle(holder).overflowX);
    if (!isScrolled || holder.tabIndex < 0 || holder.getAttribute('role') !== 'region' || !isNamed(holder)) {
      faults.push(`scroll: ${say(table)} is wider than its place, which is no named region that Tab reaches and that scrolls`);
    }
  }

  // Labels and references.
  for (const element of all('input:not([type=hidden]), select, textarea').filter(isSpoken)) {
    if (['button', 'submit', 'reset', 'image'].includes(element.type)) continue;
    const labels = [...(element.labels ?? [])].some((label) => label.textContent.trim());
    if (!labels && !isNamed(element)) faults.push(`label: ${say(element)} ${element.name || element.type} has none`);
  }
  for (const attribute of ['aria-labelledby', 'aria-describedby', 'aria-controls', 'aria-activedescendant', 'aria-owns']) {
    for (const element of all(`[${attribute}]`)) {
      const isClosed = attribute === 'aria-controls' && element.getAttribute('aria-expanded') === 'false';
      if (!isClosed && referred(element, attribute).includes(null)) {
        faults.push(`reference: ${attribute} of ${say(element)} leads nowhere`);
      }
    }
  }
  for (const label of all('label[for]')) {
    if (!document.getElementById(label.htmlFor)) faults.push(`reference: ${say(label)} labels nothing`);
  }
  for (const element of all('dialog[open], [role=tablist], [role=radiogroup], canvas, video').filter(isSpoken)) {
    if (!isNamed(element)) faults.push(`name: ${say(element)} has none`);
  }
  for (const element of all('svg').filter(isSpoken)) {
    const isDecoration = ['presentation', 'none'].includes(element.getAttribute('role'));
    const hasTitle = [...element.children].some((child) => child.localName === 'title' && child.textContent.trim());
    const isSpokenFor = element.closest(CONTROLS);
    if (!isDecoration && !isNamed(element) && !hasTitle && !isSpokenFor) {
      faults.push(`picture: ${say(element)} has neither title nor label`);
    }
  }
  for (const table of all('table').filter(isSpoken)) {
    if (!table.querySelector('th')) faults.push(`table: ${say(table)} has no headings`);
  }
  for (const element of all('[role=button], [role=link], [role=checkbox], [role=switch]').filter(isSpoken)) {
    if (element.tabIndex < 0 && !element.closest('button, a[href]') && element.getAttribute('aria-disabled') !== 'true') {
      faults.push(`keyboard: ${say(element)} cannot get the focus`);
    }
  }

  // Texts in drawings, against what is painted behind the drawing.
  const brush = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
  const known = new Map();
  const parse = (colour) => {
    if (!known.has(colour)) {
      brush.clearRect(0, 0, 1, 1);
      brush.fillStyle = '#000';
      brush.fillStyle = colour;
      brush.fillRect(0, 0, 1, 1);
      const [red, green, blue, alpha] = brush.getImageData(0, 0, 1, 1).data;
      known.set(colour, [red, green, blue, alpha / 255]);
    }
    return known.get(colour);
  };
  const over = (front, back) => [0, 1, 2].map((i) => front[i] * front[3] + back[i] * (1 - front[3])).concat(1);
  const canvasGround = () => parse(getComputedStyle(document.documentElement).colorScheme.startsWith('dark') ? '#121212' : '#fff');
  const groundOf = (element) => {
    const layers = [];
    let opacity = 1;
    for (let node = element; node; node = node.parentElement) {
      const style = getComputedStyle(node);
      if (style.backgroundImage !== 'none') return null;  // a picture or a gradient: nobody can tell by colours alone
      const layer = parse(style.backgroundColor);
      if (layer[3] > 0) layers.push(layer);
      opacity *= Number(style.opacity);
      if (layer[3] === 1) break;
    }
    return [layers.reduceRight((back, front) => over(front, back), canvasGround()), opacity];
  };
  const light = (colour) => {
    const [red, green, blue] = colour.map((value) => value / 255)
      .map((value) => value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
  };
  for (const element of all('svg text, svg tspan', scope)) {
    const isOwnText = [...element.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.textContent.trim());
    if (!isOwnText || !shows(element) || isClipped(element)) continue;
    const style = getComputedStyle(element);
    const isPaintedOver = style.paintOrder === 'normal' && element.ownerSVGElement.querySelector('rect, path, circle, polygon, image');
    const isGroundTold = element.closest('[data-ground]');  // a drawing says itself what lies behind its texts
    if (isPaintedOver && !isGroundTold && element.closest('g, svg').querySelector('rect')) continue;
    const ground = groundOf(element.ownerSVGElement);
    if (!ground) continue;
    const [back, opacity] = ground;
    const ink = parse(style.fill === 'none' ? style.color : style.fill);
    const front = over([...ink.slice(0, 3), ink[3] * opacity], back);
    const [high, low] = [light(front), light(back)].sort((a, b) => b - a);
    const contrast = (high + 0.05) / (low + 0.05);
    const size = parseFloat(style.fontSize);
    const isLarge = size >= LARGE_PX || (size >= LARGE_BOLD_PX && Number(style.fontWeight) >= 700);
    if (contrast < (isLarge ? CONTRAST_LARGE_MIN : CONTRAST_MIN) - 0.01) {
      faults.push(`contrast: ${contrast.toFixed(2)} for ${say(element)}`);
    }
  }

  // Targets for a finger: 24 px, unless the link stands in a sentence or the label beside it is as good to hit.
  for (const element of all(CONTROLS, scope).filter(isSpoken)) {
    if (isClipped(element) || element.matches(':disabled') || element.closest('.visually-hidden, .skip-link')) continue;
    const box = element.getBoundingClientRect();
    const hit = [box, ...[...(element.labels ?? [])].map((label) => label.getBoundingClientRect())];
    if (hit.some((one) => one.width >= TARGET_MIN_PX - 0.5 && one.height >= TARGET_MIN_PX - 0.5)) continue;
    const isInText = element.localName === 'a' && getComputedStyle(element).display === 'inline' &&
      (element.parentElement.textContent.trim().length > element.textContent.trim().length || element.closest('p, li, td, dd'));
    if (!isInText) faults.push(`target: ${say(element)} is ${Math.round(box.width)} x ${Math.round(box.height)} px`);
  }

  // What the Tab key has to reach. Of radio buttons of one name the browser reaches one.
  const order = all('a[href], button, input:not([type=hidden]), select, textarea, summary, [tabindex]', scope).filter((element) => {
    if (element.tabIndex < 0 || element.matches(':disabled') || !shows(element) || element.type === 'radio') return false;
    return element.localName !== 'summary' || element.parentElement.localName === 'details';
  });
  order.forEach((element, index) => { element.dataset.tabStop = String(index); });
  return { faults, stops: order.map(say) };
}
