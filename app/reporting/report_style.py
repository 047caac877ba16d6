"""The style sheet of the report: screen in light and dark, and paper."""

STYLE = """
:root{
 --page:#f6f7f9;--card:#ffffff;--ink:#16202b;--muted:#5b6875;--rule:#dfe4ea;
 --accent:#1f63c6;--second:#b45309;--third:#0f7b6c;--good:#0f7b45;--warn:#a34800;
 --tint:#eef3fb;--warn-tint:#fdf3e6;color-scheme:light dark}
@media screen and (prefers-color-scheme:dark){:root{
 --page:#0f141a;--card:#171e26;--ink:#e6ebf1;--muted:#9aa8b6;--rule:#2b3642;
 --accent:#6ea8fe;--second:#f0a35a;--third:#4fc3b0;--good:#5ccf8f;--warn:#f0a35a;
 --tint:#1b2735;--warn-tint:#2c2319}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--page);color:var(--ink);
 font:15px/1.55 system-ui,"Segoe UI",Roboto,"Noto Sans",Arial,sans-serif}
main{max-width:1040px;margin:0 auto;padding:40px 24px 64px}
header p{margin:0;color:var(--muted)}
h1{font-size:30px;line-height:1.2;margin:2px 0 6px;letter-spacing:-.01em}
.kind{text-transform:uppercase;letter-spacing:.09em;font-size:12px;font-weight:600}
section{background:var(--card);border:1px solid var(--rule);border-radius:10px;
 padding:22px 26px;margin-top:18px}
h2{font-size:19px;margin:0 0 10px;line-height:1.3}
h2 span{color:var(--muted);font-weight:400;margin-right:.45em}
h3{font-size:15px;margin:24px 0 6px}
p{margin:8px 0;max-width:92ch}
.n:last-child{padding-right:2px}
.note{color:var(--muted);font-size:13.5px}
.tiles{display:grid;grid-template-columns:repeat(4,1fr);gap:14px;margin-top:22px}
.tile{background:var(--card);border:1px solid var(--rule);border-radius:10px;
 padding:14px 16px}
.tile b{display:block;font-size:26px;line-height:1.25;letter-spacing:-.01em;
 font-variant-numeric:tabular-nums;white-space:nowrap}
.tile b small{font-size:15px;font-weight:500;color:var(--muted)}
.tile em{display:block;font-style:normal;font-size:13px;font-weight:600}
.tile i{display:block;font-style:normal;font-size:12.5px;line-height:1.4;
 color:var(--muted);margin-top:2px}
.good b{color:var(--good)}.warn b{color:var(--warn)}
.callout{border-left:4px solid var(--accent);background:var(--tint);padding:10px 16px;
 border-radius:0 8px 8px 0;margin:12px 0}
.callout.warn{border-color:var(--second);background:var(--warn-tint)}
.callout p{margin:4px 0;max-width:none}
figure{margin:14px 0 4px}
figure svg{display:block;width:100%;height:auto}
figure svg *{stroke-linejoin:round;stroke-linecap:butt}
figcaption{color:var(--muted);font-size:13px;margin-top:4px;max-width:112ch}
.scroll{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-size:13.5px;
 font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:5px 12px 5px 0;border-bottom:1px solid var(--rule);
 vertical-align:top}
th{color:var(--muted);font-weight:600;font-size:12.5px}
td.n,th.n{text-align:right;white-space:nowrap}
tr:last-child td{border-bottom:0}
td code,dd code,p code{font:12.5px ui-monospace,"SF Mono",Consolas,monospace;
 overflow-wrap:anywhere}
dl{display:grid;grid-template-columns:max-content 1fr;gap:5px 22px;margin:10px 0;
 font-size:14px}
dt{color:var(--muted)}dd{margin:0}
ul{padding-left:20px;margin:8px 0}li{margin:4px 0}
details{margin-top:10px}
summary{cursor:pointer;color:var(--accent);font-size:13.5px}
footer{color:var(--muted);font-size:12.5px;margin-top:22px}
@media screen and (max-width:760px){.tiles{grid-template-columns:repeat(2,1fr)}
 main{padding:20px 12px}section{padding:16px}figure{overflow-x:auto}
 figure svg{min-width:640px}dl{grid-template-columns:1fr;gap:0}dd{margin-bottom:8px}}
@media print{
 @page{size:A4;margin:14mm}
 body{background:none;font-size:10.5pt}
 main{max-width:none;padding:0}
 section,.tile{border-color:#cfd6dd}
 section{padding:12px 14px;break-inside:auto}
 .tiles{gap:8px}.tile{padding:9px 11px}.tile b{font-size:17px}
 th,td{padding-top:3px;padding-bottom:3px}
 h2,h3{break-after:avoid}
 figure,.tile,tr,dl,.callout{break-inside:avoid}
 details:not([open]){display:none}
}
"""
