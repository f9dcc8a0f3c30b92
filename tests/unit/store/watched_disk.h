// The calls by which the program changes folders and makes files durable, and by which it looks whether it may: noted,
// and refused where a test wants it.

#ifndef TESTS_UNIT_STORE_WATCHED_DISK_H_
#define TESTS_UNIT_STORE_WATCHED_DISK_H_

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace deltaray {

struct DiskCall {
  enum Kind { kSync, kRename, kUnlink, kMakeFolder, kAccess } kind;
  std::string path;  // where the file or folder was
  std::string to;    // kRename
  int64_t size = 0;  // kSync, kRename: bytes of the file
};

// While one is there, the calls of all threads that succeed are noted. Not more than one at a time.
class WatchedDisk {
 public:
  // The error (an errno) that a call is to have; 0: the system decides.
  explicit WatchedDisk(std::function<int(const DiskCall&)> refuse = nullptr);
  ~WatchedDisk();

  // Since the last time.
  std::vector<DiskCall> TakeCalls();
};

// A sync of `folder` fails: as where the disk fails between a rename or unlink there and its reply.
std::function<int(const DiskCall&)> FailSyncsOf(const std::string& folder);

}  // namespace deltaray

#endif  // TESTS_UNIT_STORE_WATCHED_DISK_H_
