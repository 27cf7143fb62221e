# Fails `failures` times, then succeeds. A program starts anew for each try, so it counts in a file of its own folder,
# which is gone with the mission.
failures=${1#failures=}
count=$(cat "$DCA_DIR/tries" 2>/dev/null || echo 0)
echo $((count + 1)) >"$DCA_DIR/tries"
[ "$count" -ge "$failures" ] || { echo "try $count failed" >&2; exit 1; }
echo "try $count succeeded"
