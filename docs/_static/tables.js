// Each cell knows its column's heading, which a phone shows before the cell.
document.addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll("article table.docutils")) {
    const headings = [...table.querySelectorAll("thead th")].map((cell) => cell.textContent.trim());
    for (const row of table.querySelectorAll("tbody tr")) {
      [...row.children].forEach((cell, column) => {
        const told = column > 0 && headings[column] && cell.textContent.trim();
        if (told) cell.dataset.heading = headings[column];
      });
    }
  }
});
