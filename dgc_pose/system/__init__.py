"""Files, texts, arrays, options, parallel work, and one module for each library with a set-up."""
