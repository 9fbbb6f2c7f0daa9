// Run in a page: what somebody with a screen reader, a keyboard, weak eyes or unsteady hands would stumble over.
// Checks of our own after WCAG 2.2 (A and AA): they find what a program can find, and no program finds everything.
() => {
  const faults = [];
  const CONTRAST_MIN = 4.5, CONTRAST_LARGE_MIN = 3, LARGE_PX = 24, LARGE_BOLD_PX = 18.66, TARGET_MIN_PX = 24;
  const CONTROLS = 'button, a[href], input:not([type=hidden]), select, textarea, summary, [role=button], [role=tab], ' +
    '[role=link], [role=checkbox], [role=switch], [role=radio], [role=menuitem], [role=option], [role=slider]';
  const ROLES = new Set(('alert alertdialog application article banner button cell checkbox columnheader combobox ' +
    'complementary contentinfo definition dialog document feed figure form grid gridcell group heading img link list ' +
    'listbox listitem log main marquee math menu menubar menuitem menuitemcheckbox menuitemradio meter navigation none ' +
    'note option presentation progressbar radio radiogroup region row rowgroup rowheader scrollbar search searchbox ' +
    'separator slider spinbutton status switch tab table tablist tabpanel term textbox timer toolbar tooltip tree ' +
    'treegrid treeitem').split(' '));
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
  const textOf = (node) => {
    if (node.nodeType === Node.TEXT_NODE) return node.textContent;
    if (node.nodeType !== Node.ELEMENT_NODE || node.getAttribute('aria-hidden') === 'true') return '';
    if (node.getAttribute('aria-label')) return node.getAttribute('aria-label');
    if (node.localName === 'img') return node.getAttribute('alt') || '';
    if (node.localName === 'svg') return all('title', node).map((title) => title.textContent).join(' ');
    return [...node.childNodes].map(textOf).join(' ');
  };
  const labelsOf = (element) => [...(element.labels ?? [])].map(textOf).join(' ').trim();
  const nameOf = (element) => {
    const parts = [referred(element, 'aria-labelledby').filter(Boolean).map(textOf).join(' ')];
    parts.push(element.getAttribute('aria-label') || '', labelsOf(element));
    if (['button', 'submit', 'reset'].includes(element.type)) parts.push(element.value || '');
    if (element.localName === 'input' && element.type === 'image') parts.push(element.alt || '');
    if (!['input', 'select', 'textarea'].includes(element.localName)) parts.push(textOf(element));
    parts.push(element.getAttribute('title') || '');
    return parts.map((part) => part.trim()).find(Boolean) || '';
  };

  // The document.
  if (!document.documentElement.lang) faults.push('language: <html> has no lang');
  if (!document.title.trim()) faults.push('title: the page has none');
  const zoom = document.querySelector('meta[name=viewport]')?.content || '';
  if (/user-scalable\s*=\s*(no|0)|maximum-scale\s*=\s*[0-4](\.|$|,|\s)/.test(zoom)) faults.push(`zoom: forbidden by ${zoom}`);
  const seen = new Set();
  for (const element of all('[id]')) {
    if (seen.has(element.id)) faults.push(`id: ${element.id} stands twice`);
    seen.add(element.id);
  }
  const root = document.scrollingElement;
  if (root.scrollWidth > root.clientWidth + 1) {
    faults.push(`reflow: the page is ${root.scrollWidth} px wide in a window of ${root.clientWidth} px`);
  }

  // Names, labels, references, roles.
  for (const element of all(CONTROLS).filter(isSpoken)) {
    if (!nameOf(element)) faults.push(`name: ${say(element)} has none`);
    const isField = ['input', 'select', 'textarea'].includes(element.localName) &&
      !['button', 'submit', 'reset', 'image'].includes(element.type);
    if (isField && !labelsOf(element) && !element.getAttribute('aria-label') && !element.getAttribute('aria-labelledby')) {
      faults.push(`label: ${say(element)} ${element.name || element.type} has none`);
    }
    const outer = element.parentElement?.closest('button, a[href], [role=button], [role=link]');
    if (outer) faults.push(`nesting: ${say(element)} is inside ${say(outer)}`);
  }
  for (const element of all('[role]')) {
    for (const role of element.getAttribute('role').split(/\s+/)) {
      if (!ROLES.has(role)) faults.push(`role: ${say(element)} has the unknown role ${role}`);
    }
    if (element.getAttribute('role') === 'tab' && !element.closest('[role=tablist]')) {
      faults.push(`role: ${say(element)} is a tab outside of a tablist`);
    }
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
  for (const element of all('dialog[open], [role=dialog], [role=tablist], [role=radiogroup], iframe').filter(isSpoken)) {
    const heading = element.localName === 'iframe' ? element.title : '';
    if (!nameOf(element).trim() && !heading) faults.push(`name: ${say(element)} has none`);
    if (element.localName === 'dialog' && !element.getAttribute('aria-label') && !element.getAttribute('aria-labelledby')) {
      faults.push(`name: ${say(element)} has neither aria-label nor aria-labelledby`);
    }
  }

  // Pictures.
  for (const element of all('img').filter(shows)) {
    if (!element.hasAttribute('alt')) faults.push(`picture: ${say(element)} ${element.src.slice(0, 60)} has no alt`);
  }
  for (const element of all('svg').filter(isSpoken)) {
    const isDecoration = element.getAttribute('role') === 'presentation' || element.getAttribute('role') === 'none';
    const isNamed = element.getAttribute('aria-label') || element.getAttribute('aria-labelledby') ||
      [...element.children].some((child) => child.localName === 'title' && child.textContent.trim());
    const isSpokenFor = element.closest(CONTROLS) && nameOf(element.closest(CONTROLS));
    if (!isDecoration && !isNamed && !isSpokenFor) faults.push(`picture: ${say(element)} has neither title nor label`);
  }
  for (const element of all('canvas, video, [role=img]').filter(isSpoken)) {
    if (element.localName === 'svg') continue;
    if (!nameOf(element)) faults.push(`picture: ${say(element)} has no name`);
  }

  // Headings, landmarks, tables.
  const headings = all('h1, h2, h3, h4, h5, h6, [role=heading]').filter(isSpoken).filter((one) => !one.closest('dialog'));
  const levels = headings.map((one) => Number(one.getAttribute('aria-level') || one.localName.slice(1)));
  if (!modal) {
    if (levels.filter((level) => level === 1).length !== 1) {
      faults.push(`headings: ${levels.filter((level) => level === 1).length} of the first level`);
    }
    levels.forEach((level, index) => {
      const before = index ? levels[index - 1] : 0;
      if (level > before + 1) faults.push(`headings: ${say(headings[index])} goes from level ${before} to ${level}`);
    });
    const mains = all('main, [role=main]').filter(isSpoken);
    if (mains.length !== 1) faults.push(`landmarks: ${mains.length} main parts`);
    const navigations = all('nav, [role=navigation]').filter(isSpoken);
    const names = navigations.map((one) => one.getAttribute('aria-label') || referred(one, 'aria-labelledby').map(textOf).join(' '));
    if (navigations.length > 1 && new Set(names.filter(Boolean)).size < navigations.length) {
      faults.push('landmarks: several navigations that are not told apart by names');
    }
  }
  for (const heading of headings) if (!textOf(heading).trim()) faults.push(`headings: ${say(heading)} is empty`);
  for (const table of all('table').filter(isSpoken)) {
    if (!table.querySelector('th')) faults.push(`table: ${say(table)} has no headings`);
  }

  // Keyboard.
  for (const element of all('[tabindex]')) {
    if (element.tabIndex > 0) faults.push(`order: ${say(element)} has tabindex ${element.tabIndex}`);
  }
  for (const element of all('[role=button], [role=link], [role=checkbox], [role=switch]').filter(isSpoken)) {
    if (element.tabIndex < 0 && !element.closest('button, a[href]') && element.getAttribute('aria-disabled') !== 'true') {
      faults.push(`keyboard: ${say(element)} cannot get the focus`);
    }
  }
  for (const hidden of all('[aria-hidden=true]')) {
    const inside = [hidden, ...all('*', hidden)].find((element) => element.matches(CONTROLS) && element.tabIndex >= 0 && shows(element));
    if (inside) faults.push(`keyboard: ${say(inside)} gets the focus and is hidden from screen readers`);
  }

  // Colours: each text against what is painted behind it.
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
      if (node.localName === 'dialog' && node.matches(':modal') && layer[3] < 1) return null;
    }
    return [layers.reduceRight((back, front) => over(front, back), canvasGround()), opacity];
  };
  const light = (colour) => {
    const [red, green, blue] = colour.map((value) => value / 255)
      .map((value) => value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
  };
  const told = new Set();
  const walker = document.createTreeWalker(scope, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const element = node.parentElement;
    if (!node.textContent.trim() || !element || told.has(element)) continue;
    if (['script', 'style', 'title', 'desc', 'option', 'noscript'].includes(element.localName)) continue;
    if (!shows(element) || isClipped(element)) continue;
    if (element.closest(':disabled, [aria-disabled=true], .visually-hidden')) continue;
    told.add(element);
    const style = getComputedStyle(element);
    const ownerSvg = element.closest('svg');
    if (ownerSvg && [...all('rect, path, circle, polygon, image', ownerSvg)].length && style.paintOrder === 'normal') {
      const painted = element.closest('[data-ground]')?.dataset.ground;  // a drawing says itself what lies behind its texts
      if (!painted && element.closest('g, svg').querySelector('rect')) continue;
    }
    const ground = groundOf(ownerSvg ? ownerSvg : element);
    if (!ground) continue;
    const [back, opacity] = ground;
    const ink = parse(ownerSvg && style.fill !== 'none' ? style.fill : style.color);
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
  const radios = new Set();
  const order = all('a[href], button, input:not([type=hidden]), select, textarea, summary, [tabindex]', scope).filter((element) => {
    if (element.tabIndex < 0 || element.matches(':disabled') || !shows(element)) return false;
    if (element.localName === 'summary' && element.parentElement.localName !== 'details') return false;
    if (element.type === 'radio') {
      if (radios.has(element.name)) return false;
      radios.add(element.name);
      return false;
    }
    return true;
  });
  order.forEach((element, index) => { element.dataset.tabStop = String(index); });
  return { faults, stops: order.map(say) };
}
