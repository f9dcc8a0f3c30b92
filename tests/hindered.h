// Makes the system refuse things, for a time.

#ifndef TESTS_HINDERED_H_
#define TESTS_HINDERED_H_

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>

namespace deltaray {

// No file can be written past `bytes`.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) {
    handler_ = signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &before_);
    rlimit limit = before_;
    limit.rlim_cur = bytes;
    EXPECT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  }
  ~FileSizeLimit() {
    setrlimit(RLIMIT_FSIZE, &before_);
    signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_;
  void (*handler_)(int);
};

// No file can be opened any more.
class NoFileDescriptors {
 public:
  NoFileDescriptors() {
    getrlimit(RLIMIT_NOFILE, &before_);
    rlimit limit = before_;
    limit.rlim_cur = 0;
    EXPECT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
  }
  ~NoFileDescriptors() { setrlimit(RLIMIT_NOFILE, &before_); }

 private:
  rlimit before_;
};

// Root may write anywhere; with this the process is nobody, where it was root.
class WithoutPrivileges {
 public:
  WithoutPrivileges() : before_(geteuid()) { EXPECT_TRUE(before_ != 0 || seteuid(65534) == 0); }
  ~WithoutPrivileges() { EXPECT_TRUE(before_ != 0 || seteuid(0) == 0); }

 private:
  const uid_t before_;
};

// From here on this process can make no thread: it is nobody, for good, where it was root, whom no limit on threads
// binds.
inline void ForbidThreads() {
  EXPECT_TRUE(getuid() != 0 || setuid(65534) == 0);
  const rlimit none{0, 0};
  EXPECT_EQ(setrlimit(RLIMIT_NPROC, &none), 0);
}

}  // namespace deltaray

#endif  // TESTS_HINDERED_H_
