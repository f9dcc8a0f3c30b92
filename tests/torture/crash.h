// Kills servers at random moments, and looks for what is lost.

#ifndef TESTS_TORTURE_CRASH_H_
#define TESTS_TORTURE_CRASH_H_

#include <cstdint>
#include <string>

namespace deltaray {

struct CrashOptions {
  std::string binary;  // empty: the deltarayd beside this program
  std::string directory;
  int servers = 1;  // that share the directory
  int rounds = 300;
  uint64_t seed = 1;
};

// Each round, clients upload, name, rebuild, delete and query meshes of their own while some of the servers are killed.
// After their restart every server must have what was acknowledged, with the right answers; what was not is there as a
// whole or not at all, for all alike; and no file belongs to nothing. No server may end by itself. Prints a line of
// figures. False: something was lost or a server was, or nothing was acknowledged at all; it is told of.
bool TortureByCrashes(const CrashOptions& options);

}  // namespace deltaray

#endif  // TESTS_TORTURE_CRASH_H_
