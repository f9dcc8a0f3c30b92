// A session whose streams are files, so that a test sees what a command wrote.

#ifndef TESTS_UNIT_CLIENT_TEST_SESSION_H_
#define TESTS_UNIT_CLIENT_TEST_SESSION_H_

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <initializer_list>
#include <iterator>
#include <string>
#include <vector>

#include "client/command_line.h"
#include "client/session.h"

namespace deltaray {

class TestSession {
 public:
  explicit TestSession(const std::string& server = "127.0.0.1:1")
      : session_{.input_fd = open("/dev/null", O_RDONLY | O_CLOEXEC),
                 .output = std::tmpfile(),
                 .messages = std::tmpfile(),
                 .show_progress = false,
                 .stop = stop,
                 .server = server,
                 .timeout_seconds = 20,
                 .retry_seconds = 0} {}

  ~TestSession() {
    close(session_.input_fd);
    std::fclose(session_.output);
    std::fclose(session_.messages);
  }

  // Runs one command line, without the program's name, and returns the exit code.
  int Run(std::initializer_list<std::string> arguments) {
    std::vector<const char*> argv = {"deltaray"};
    for (const std::string& argument : arguments) argv.push_back(argument.c_str());
    return RunCommandLine(static_cast<int>(argv.size()), argv.data(), session_);
  }

  void SetInput(const std::string& bytes) {
    std::FILE* file = std::tmpfile();
    std::fwrite(bytes.data(), 1, bytes.size(), file);
    std::fflush(file);
    lseek(fileno(file), 0, SEEK_SET);
    SetInputFd(dup(fileno(file)));
    std::fclose(file);
  }

  // Takes the descriptor over.
  void SetInputFd(int fd) {
    close(session_.input_fd);
    session_.input_fd = fd;
  }

  // What was written since the last call.
  std::string TakeOutput() { return Take(session_.output); }
  std::string TakeMessages() { return Take(session_.messages); }

  Session& session() { return session_; }

  StopSignal stop;

 private:
  static std::string Take(std::FILE* file) {
    std::fflush(file);
    std::rewind(file);
    std::string text;
    for (int c = std::fgetc(file); c != EOF; c = std::fgetc(file)) text += static_cast<char>(c);
    std::rewind(file);
    EXPECT_EQ(ftruncate(fileno(file), 0), 0);
    return text;
  }

  Session session_;
};

// A file with the given bytes, removed at the end.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::string& bytes) {
    char path[] = "/tmp/deltaray_client_test_XXXXXX";
    close(mkstemp(path));
    path_ = path;
    std::ofstream(path_, std::ios::binary) << bytes;
  }
  ~TemporaryFile() { std::remove(path_.c_str()); }

  const std::string& path() const { return path_; }

  std::string Read() const {
    std::ifstream file(path_, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(file), {});
  }

 private:
  std::string path_;
};

}  // namespace deltaray

#endif  // TESTS_UNIT_CLIENT_TEST_SESSION_H_
