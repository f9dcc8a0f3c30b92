// Records what clients are answered while servers fail, and checks it against what was done.

#ifndef TESTS_TORTURE_HISTORY_H_
#define TESTS_TORTURE_HISTORY_H_

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

namespace deltaray {

// One call. Times are nanoseconds of one clock.
struct Event {
  enum class Kind { kUpload, kMove, kDelete, kAsk };
  // kUnknown: the call may have had its effect, or may have it at any later time.
  enum class Outcome { kDone, kNotFound, kUnknown };

  Kind kind = Kind::kAsk;
  int64_t begin = 0, end = 0;
  Outcome outcome = Outcome::kUnknown;
  // Of an upload, a move or a delete: its mesh. Of an ask: the mesh that was asked by id, -1 where it was by name; once
  // it is done, the mesh that answered.
  int mesh = -1;
  int name = -1;  // -1: none
};

// What is wrong with the history: a sentence for each reply that no mesh could have given that was live, or that its
// name led to, during the call or up to `stale` before it.
std::vector<std::string> CheckHistory(const std::vector<Event>& events, std::chrono::nanoseconds stale);

struct HistoryOptions {
  std::string binary;  // empty: the deltarayd beside this program
  std::string directory;
  int servers = 3;  // that share the directory
  double seconds = 60;
  uint64_t seed = 1;
};

// Clients upload, move, delete and ask the same few meshes and names through all servers, some of which are killed and
// started again, or stopped for a time, while connections are cut. All answers must be those of brute force, all
// streams must have each batch once and in order, and the history must check. No server may end by itself. Prints a
// line of figures. False: something was wrong, or nothing was answered at all; it is told of.
bool TortureByHistory(const HistoryOptions& options);

}  // namespace deltaray

#endif  // TESTS_TORTURE_HISTORY_H_
