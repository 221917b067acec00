"""Files and their texts, arrays, options, parallel work, and libraries behind one module each."""
