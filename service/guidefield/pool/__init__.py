"""Worker processes behind a bounded queue, processes of single conversations, and the way of answers to clients."""
