// A search needs a server: from the disk (file:) its worker never answers, and the field would stay at "Initializing".
if (location.protocol === "file:") document.documentElement.classList.add("from-disk");
