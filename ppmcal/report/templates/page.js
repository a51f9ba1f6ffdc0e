document.querySelectorAll('table.sort').forEach(function(t){
t.querySelectorAll('thead th').forEach(function(h,i){
if(!h.textContent)return;
var b=document.createElement('button');b.type='button';b.title='Sort';
while(h.firstChild)b.appendChild(h.firstChild);h.appendChild(b);
b.onclick=function(){var up=h.getAttribute('aria-sort')!=='ascending';
t.querySelectorAll('thead th').forEach(function(o){o.removeAttribute('aria-sort')});
h.setAttribute('aria-sort',up?'ascending':'descending');
var k=function(r){var c=r.cells[i];return c.dataset.v!==undefined?+c.dataset.v:c.textContent};
var rows=Array.from(t.tBodies[0].rows);
rows.sort(function(p,q){var a=k(p),b=k(q),na=typeof a==='number',nb=typeof b==='number';
if(na!==nb)return na?-1:1;
var d=na?a-b:String(a).localeCompare(String(b),'en',{numeric:true});return up?d:-d});
rows.forEach(function(r){t.tBodies[0].appendChild(r)})}})});
