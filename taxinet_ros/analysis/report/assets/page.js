// Puts life into the page. Without it everything but the viewers can be read all the same.

startThemeButton(document.getElementById('theme'));
const runIds = document.getElementById('run-ids');
const viewers = new Set(runIds ? readBlock(runIds) : []);
for (const root of document.querySelectorAll('.table')) new ReportTable(root, viewers);
if (runIds) new Viewer(document.getElementById('viewer'));
