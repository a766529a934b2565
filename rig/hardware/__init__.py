"""Cards and cameras, the bench made of them, its lock and its venting."""
