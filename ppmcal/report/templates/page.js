(function () {
'use strict';
const all = (what, from) => Array.from((from || document).querySelectorAll(what));

/* contents: open where there is room beside the page; a link opens what it leads to */
const contents = document.querySelector('.toc details');
const wide = window.matchMedia('(min-width:1180px)');
const room = () => { if (contents) contents.open = wide.matches; };
room();
wide.addEventListener('change', room);
function unfold(node) {
  for (let n = node; n; n = n.parentElement) if (n.tagName === 'DETAILS') n.open = true;
}
function follow() {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (target) { unfold(target); target.scrollIntoView(); }
}
window.addEventListener('hashchange', follow);
all('.toc a').forEach(a => a.addEventListener('click', () => {
  const target = document.getElementById(a.hash.slice(1));
  if (target) unfold(target);
  if (!wide.matches) contents.open = false;
}));
if (location.hash) follow();
if (window.IntersectionObserver) {
  const links = new Map(all('.toc a').map(a => [a.hash.slice(1), a]));
  const seen = new Set();
  const watch = new IntersectionObserver(entries => {
    entries.forEach(e => e.isIntersecting ? seen.add(e.target.id) : seen.delete(e.target.id));
    const here = Array.from(links.keys()).filter(id => seen.has(id));
    links.forEach((a, id) => a.classList.toggle('here', id === here[here.length - 1]));
  }, {rootMargin: '0px 0px -70% 0px'});
  all('.chapter,.part').forEach(s => watch.observe(s));
}
let folded = [];
window.addEventListener('beforeprint', () => {
  folded = all('details.part:not([open])');
  folded.forEach(d => { d.open = true; });
});
window.addEventListener('afterprint', () => folded.forEach(d => { d.open = false; }));

/* tables: sorted by a click on a head, searched, copied for a spreadsheet */
function sorted(table) {
  all('thead th', table).forEach((head, i) => {
    if (!head.textContent) return;
    const button = document.createElement('button');
    button.type = 'button';
    button.title = 'Sort';
    while (head.firstChild) button.appendChild(head.firstChild);
    head.appendChild(button);
    button.onclick = () => {
      const up = head.getAttribute('aria-sort') !== 'ascending';
      all('thead th', table).forEach(o => o.removeAttribute('aria-sort'));
      head.setAttribute('aria-sort', up ? 'ascending' : 'descending');
      const key = row => {
        const cell = row.cells[i];
        return cell.dataset.v !== undefined ? +cell.dataset.v : cell.textContent;
      };
      const body = table.tBodies[0];
      Array.from(body.rows).sort((p, q) => {
        const a = key(p), b = key(q), na = typeof a === 'number', nb = typeof b === 'number';
        if (na !== nb) return na ? -1 : 1;
        const d = na ? a - b : String(a).localeCompare(String(b), 'en', {numeric: true});
        return up ? d : -d;
      }).forEach(row => body.appendChild(row));
    };
  });
}
const cellText = cell => cell.dataset.v !== undefined ? cell.dataset.v : cell.textContent.trim();
function asText(table) {
  return all('tr', table).filter(r => !r.hidden).map(r => Array.from(r.cells).map(
    c => c.parentElement.parentElement.tagName === 'THEAD' ? c.textContent.trim() : cellText(c)
  ).join('\t')).join('\n');
}
function copy(text) {
  if (navigator.clipboard && window.isSecureContext) return navigator.clipboard.writeText(text);
  const area = document.createElement('textarea');
  area.value = text;
  document.body.appendChild(area);
  area.select();
  const done = document.execCommand('copy');
  area.remove();
  return done ? Promise.resolve() : Promise.reject(new Error('not copied'));
}
function tools(table) {
  const rows = Array.from(table.tBodies[0].rows), bar = document.createElement('div');
  if (rows.length < 5) return;
  bar.className = 'tools';
  const left = document.createElement('span');
  left.className = 'left';
  if (rows.length > 12) {
    const field = document.createElement('input');
    field.type = 'search';
    field.placeholder = `search ${rows.length} rows`;
    field.setAttribute('aria-label', 'Show the rows that hold these words');
    field.oninput = () => {
      const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
      let n = 0;
      rows.forEach(r => {
        const text = r.textContent.toLowerCase();
        r.hidden = !words.every(w => text.includes(w));
        n += !r.hidden;
      });
      left.textContent = words.length ? `${n} of ${rows.length}` : '';
    };
    bar.appendChild(field);
  }
  const button = document.createElement('button');
  button.type = 'button';
  button.textContent = 'copy';
  button.title = 'Copy the rows that are shown, for a spreadsheet';
  button.onclick = () => copy(asText(table)).then(
    () => { left.textContent = 'copied'; }, () => { left.textContent = 'could not be copied'; });
  bar.append(button, left);
  table.parentElement.before(bar);
}
all('.scroll>table').forEach(t => { if (t.classList.contains('sort')) sorted(t); tools(t); });

/* measured rows: chosen here, in a plot or on the machine, lit up in all of them */
const chosen = document.querySelector('.chosen');
const lines = all('tr[data-row]');
let keys = [];
function choose(list, source) {
  document.dispatchEvent(new CustomEvent('ppmcal-select', {detail: {keys: list, source: source}}));
}
lines.forEach(r => r.addEventListener('click', event => {
  if (event.target.closest('a,button')) return;
  const key = r.dataset.row, more = event.ctrlKey || event.metaKey || event.shiftKey;
  const rest = more ? keys.filter(k => k !== key) : [];
  choose(keys.includes(key) && (more || keys.length === 1) ? rest : [...rest, key], r);
}));
function called(key) {
  const [index, ...rest] = key.split(':');
  if (index === 'next') return `row ${rest} of next.csv`;
  return `${rest.slice(0, -1).join(':')} row ${rest[rest.length - 1]}`;
}
document.addEventListener('ppmcal-select', event => {
  keys = Array.from(event.detail.keys || []);
  const held = new Set(keys);
  lines.forEach(r => r.classList.toggle('lit', held.has(r.dataset.row)));
  const names = keys.slice(0, 4).map(called).join(', ');
  chosen.hidden = !keys.length;
  chosen.querySelector('span').textContent =
    keys.length > 4 ? `${keys.length} rows: ${names} …` : names;
  const lit = lines.find(r => r.classList.contains('lit'));
  const go = chosen.querySelector('.go');
  go.hidden = !lit || (event.detail.source && event.detail.source.tagName === 'TR');
  go.onclick = () => { unfold(lit); lit.scrollIntoView({block: 'center'}); };
});
chosen.querySelector('.clear').onclick = () => choose([], chosen);
document.addEventListener('keydown', event => {
  if (event.key === 'Escape' && keys.length) choose([], chosen);
});
})();
